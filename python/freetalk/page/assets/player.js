// One clock for every pane. Where there is sound, its clock leads and the picture follows.

const RATES = [0.25, 0.5, 0.75, 1, 1.5, 2];

class Player {
  constructor(onchange) {
    this.onchange = onchange;
    this.take = null; // whose sound is heard
    this.duration = 0;
    this.position = 0; // seconds, while not playing
    this.rate = 1;
    this.loop = true;
    this.region = null; // [from, to] seconds that are repeated
    this.muted = false;
    this.playing = false;
    this.context = null;
    this.source = null;
    this.buffers = new Map();
  }

  /** The sound that is heard and the length of the longest shown take. */
  use(take, duration) {
    const at = this.time();
    this.take = take;
    this.duration = duration;
    if (this.region && this.region[0] >= duration) this.region = null;
    if (this.playing) this.begin(Math.min(at, this.end));
    else this.position = Math.min(at, duration);
  }

  get start() { return this.region ? this.region[0] : 0; }
  get end() { return this.region ? Math.min(this.region[1], this.duration) : this.duration; }

  ready() {
    if (!this.context) {
      const Context = window.AudioContext || window.webkitAudioContext;
      if (!Context) return null;
      this.context = new Context({ latencyHint: "interactive" });
      this.gain = this.context.createGain();
      this.gain.connect(this.context.destination);
    }
    return this.context;
  }

  buffer() {
    if (!this.take || this.take.sound.length === 0) return null;
    if (!this.buffers.has(this.take)) {
      const { sound, rate } = this.take;
      const buffer = this.context.createBuffer(1, sound.length, rate);
      const samples = buffer.getChannelData(0);
      for (let i = 0; i < sound.length; ++i) samples[i] = sound[i] / 32768;
      this.buffers.set(this.take, buffer);
    }
    return this.buffers.get(this.take);
  }

  async play() {
    if (this.playing || !this.take) return;
    if (this.take.sound.length && this.ready() && this.context.state !== "running") {
      // A browser that holds sound back never answers: after a moment the picture plays without it.
      await Promise.race([this.context.resume(), new Promise((done) => setTimeout(done, 400))]);
    }
    this.playing = true;
    const from = this.position >= this.end - 1e-3 || this.position < this.start ? this.start : this.position;
    this.begin(from);
    this.onchange();
  }

  begin(from) {
    this.stopSource();
    this.position = from;
    this.audible = Boolean(this.context && this.context.state === "running" && this.take.sound.length);
    if (!this.audible) {
      this.began = performance.now() / 1000;
      return;
    }
    this.gain.gain.value = this.muted ? 0 : 1;
    this.began = this.context.currentTime + 0.02;
    const buffer = this.buffer();
    if (from >= buffer.duration) return;
    this.source = this.context.createBufferSource();
    this.source.buffer = buffer;
    this.source.playbackRate.value = this.rate;
    this.source.connect(this.gain);
    this.source.start(this.began, from, Math.max(this.end - from, 0));
  }

  stopSource() {
    if (!this.source) return;
    this.source.stop();
    this.source.disconnect();
    this.source = null;
  }

  pause() {
    if (!this.playing) return;
    this.position = this.time();
    this.playing = false;
    this.stopSource();
    this.onchange();
  }

  toggle() { return this.playing ? this.pause() : this.play(); }

  seek(seconds) {
    const to = clamp(seconds, 0, this.duration);
    if (this.playing) this.begin(to);
    else this.position = to;
    this.onchange();
  }

  setRate(rate) {
    const at = this.time();
    this.rate = rate;
    if (this.playing) this.begin(at);
    this.onchange();
  }

  setRegion(region) {
    this.region = region && region[1] - region[0] > 0.05 ? [Math.max(0, region[0]), Math.min(region[1], this.duration)] : null;
    if (this.region && (this.time() < this.region[0] || this.time() > this.region[1])) this.seek(this.region[0]);
    else if (this.playing) this.begin(this.time());
    this.onchange();
  }

  setMuted(muted) {
    this.muted = muted;
    if (this.gain) this.gain.gain.value = muted ? 0 : 1;
    this.onchange();
  }

  /** What leaves the loudspeaker now, on the context's clock. */
  heardAt() {
    const stamp = this.context.getOutputTimestamp?.();
    if (stamp && stamp.contextTime > 0) {
      const estimate = stamp.contextTime + (performance.now() - stamp.performanceTime) / 1000;
      return Math.min(estimate, this.context.currentTime);
    }
    return this.context.currentTime - (this.context.outputLatency || this.context.baseLatency || 0);
  }

  /** The moment that is shown. */
  time() {
    if (!this.playing) return this.position;
    const now = this.audible ? this.heardAt() : performance.now() / 1000;
    return this.position + Math.max(0, now - this.began) * this.rate;
  }

  /** To be called for every picture: repeats or ends; returns the moment to show. */
  tick() {
    const at = this.time();
    if (!this.playing || at < this.end) return Math.min(at, this.duration);
    if (this.loop && !this.recording) {
      this.begin(this.start);
      return this.start;
    }
    this.position = this.end;
    this.playing = false;
    this.stopSource();
    this.onchange();
    return this.end;
  }
}
