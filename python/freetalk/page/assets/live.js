// Live speech: samples to the server, weights back, the face and the sound in time with each other.

const BLOCK = 320; // samples of a message, 20 ms
const MARGIN_S = 0.12; // beside what the stream promises: the way there and back, and the computing
const MOST_DELAY_S = 4;

class LiveStream {
  constructor(app, address, report) {
    this.app = app;
    this.address = address;
    this.report = report;
    this.frames = []; // {time, weights}
    this.latencies = [];
    this.worst = 0;
    this.level = 0;
  }

  async start(source, emotion, hear) {
    this.context = new AudioContext({ sampleRate: SPEECH_HZ, latencyHint: "interactive" });
    await this.context.resume();
    if (source) {
      const buffer = this.context.createBuffer(1, source.sound.length, source.rate);
      buffer.getChannelData(0).forEach((_, i, data) => (data[i] = source.sound[i] / 32768));
      this.node = Object.assign(this.context.createBufferSource(), { buffer, loop: true });
    } else {
      this.stream = await openMicrophone();
      this.node = this.context.createMediaStreamSource(this.stream);
    }
    await this.connect(emotion);
    this.delay = this.facts.latency_s + MARGIN_S;
    this.echo = this.context.createDelay(MOST_DELAY_S);
    this.echo.delayTime.value = this.delay;
    this.echoGain = this.context.createGain();
    this.node.connect(this.echo).connect(this.echoGain).connect(this.context.destination);
    this.hear(hear);
    this.waiting = new Float32Array(0);
    this.began = null;
    this.worklet = await tap(this.context, this.node, (block) => this.heard(block));
    this.node.start?.();
    this.running = true;
    this.tick();
  }

  /** Opens the socket; resolves when the face is there. */
  connect(emotion) {
    return new Promise((done, fail) => {
      const socket = new WebSocket(this.address);
      socket.binaryType = "arraybuffer";
      this.socket = socket;
      socket.onopen = () => socket.send(JSON.stringify(emotion));
      socket.onmessage = async ({ data }) => {
        if (typeof data === "string") this.facts = JSON.parse(data);
        else if (!this.take) {
          this.take = {}; // frames follow only when samples were sent
          this.take = await openTake(new Uint8Array(data), "live");
          this.take.letter = "●";
          done();
        } else this.receive(data);
      };
      socket.onclose = ({ reason }) => {
        const why = new Error(reason ? `The stream ended: ${reason}.` : "The stream ended.");
        if (this.running) this.report.ended(why.message);
        fail(why);
      };
    });
  }

  heard(block) {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    if (this.began === null) this.began = this.context.currentTime - block.length / SPEECH_HZ;
    this.level = Math.max(this.level * 0.97, ...block.map(Math.abs));
    const joined = new Float32Array(this.waiting.length + block.length);
    joined.set(this.waiting);
    joined.set(block, this.waiting.length);
    let at = 0;
    for (; at + BLOCK <= joined.length; at += BLOCK) this.socket.send(toInt16(joined.subarray(at, at + BLOCK)).buffer);
    this.waiting = joined.slice(at);
  }

  receive(data) {
    const view = new DataView(data), count = this.facts.weights, size = 8 + 2 * count;
    const now = this.context.currentTime - this.began;
    for (let at = 0; at + size <= data.byteLength; at += size) {
      const time = view.getFloat32(at + 4, true);
      const weights = new Float32Array(count);
      for (let k = 0; k < count; ++k) weights[k] = view.getUint16(at + 8 + 2 * k, true) / 65535;
      this.frames.push({ time, weights });
      this.latencies.push({ at: now, seconds: now - time });
      this.worst = Math.max(this.worst, now - time);
    }
    if (this.worst > MOST_DELAY_S) {
      this.report.ended("This computer does not keep up with live speech. Close other programs, or choose a smaller mesh.");
      return;
    }
    this.latencies = this.latencies.filter(({ at }) => at > now - 1);
    if (this.worst > this.delay) {
      this.delay = this.worst + 0.05;
      this.echo.delayTime.setTargetAtTime(this.delay, this.context.currentTime, 0.1);
    }
  }

  hear(on) { this.echoGain.gain.value = on ? 1 : 0; }

  direct(emotion) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(emotion)); }

  tick() {
    if (!this.running) return;
    requestAnimationFrame(() => this.tick());
    const { frames, take } = this, now = this.began === null ? 0 : this.context.currentTime - this.began - this.delay;
    while (frames.length > 1 && frames[1].time <= now) frames.shift();
    if (frames.length) {
      const [before, after] = [frames[0], frames[1] || frames[0]];
      const share = after === before ? 0 : clamp((now - before.time) / (after.time - before.time), 0, 1);
      take.sum(before.weights.map((value, k) => take.header.step_m * (value + share * (after.weights[k] - value))));
      take.shown += 1;
      this.app.refresh();
    }
    this.report.numbers(this.latencies.map(({ seconds }) => seconds), this.worst, this.level);
  }

  stop() {
    this.running = false;
    this.socket?.close();
    for (const track of this.stream?.getTracks() || []) track.stop();
    this.context?.close();
  }
}
