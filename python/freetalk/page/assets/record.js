// Pictures and films of what the stage shows, made in the browser.

const FILM_TYPES = [
  ["video/mp4;codecs=avc1.640028,mp4a.40.2", "mp4"], ["video/webm;codecs=vp9,opus", "webm"], ["video/webm", "webm"],
];

function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

const fileName = (text) => text.replace(/[^\p{L}\p{N}._-]+/gu, "_").replace(/^_+|_+$/g, "") || "freetalk";

/** The stage with the names of its panes and the scale of errors, as one picture. */
class Composer {
  constructor(stage) {
    this.stage = stage;
    this.canvas = document.createElement("canvas");
    this.context = this.canvas.getContext("2d");
  }

  compose(panes, labels, legend) {
    const { canvas, context, stage } = this;
    if (canvas.width !== stage.width || canvas.height !== stage.height) {
      canvas.width = stage.width - (stage.width % 2);
      canvas.height = stage.height - (stage.height % 2);
    }
    context.drawImage(stage, 0, 0);
    const size = Math.max(12, Math.round(canvas.height / 42));
    context.font = `600 ${size}px system-ui, sans-serif`;
    context.textBaseline = "top";
    context.textAlign = "left";
    labels.forEach((text, i) => {
      const [x, y] = panes[i].box;
      const left = x * canvas.width + size, top = y * canvas.height + size;
      context.fillStyle = "rgba(0, 0, 0, 0.55)";
      context.fillRect(left - size / 2, top - size / 3, context.measureText(text).width + size, size * 1.7);
      context.fillStyle = "#fff";
      context.fillText(text, left, top);
    });
    if (legend) this.drawLegend(legend, size);
    return canvas;
  }

  drawLegend({ image, text }, size) {
    const { canvas, context } = this, width = canvas.width / 4;
    const left = canvas.width - width - 2 * size, top = canvas.height - 3.4 * size;
    context.fillStyle = "rgba(0, 0, 0, 0.55)";
    context.fillRect(left - size / 2, top - size / 2, width + size, 2.9 * size);
    context.drawImage(image, left, top, width, size * 0.7);
    context.fillStyle = "#fff";
    context.fillText(text, left, top + size);
  }
}

/** Plays the shown takes once from the start and keeps picture and sound. */
class Film {
  constructor(player, canvas, fps) {
    this.player = player;
    this.chunks = [];
    const found = FILM_TYPES.find(([type]) => window.MediaRecorder && MediaRecorder.isTypeSupported(type));
    if (!found) throw new Error("This browser cannot record video.");
    [this.type, this.ending] = found;
    const stream = canvas.captureStream(fps);
    if (player.take.sound.length && player.ready()) {
      this.output = player.context.createMediaStreamDestination();
      player.gain.connect(this.output);
      stream.addTrack(this.output.stream.getAudioTracks()[0]);
    }
    this.recorder = new MediaRecorder(stream, { mimeType: this.type, videoBitsPerSecond: 12e6 });
    this.recorder.ondataavailable = (event) => this.chunks.push(event.data);
  }

  async run() {
    const { player } = this;
    player.pause();
    player.recording = true;
    player.position = player.start;
    const finished = new Promise((done) => (this.recorder.onstop = done));
    this.recorder.start(500);
    await player.play();
    await new Promise((done) => {
      const watch = () => (player.playing && !this.cancelled ? requestAnimationFrame(watch) : done());
      watch();
    });
    player.pause();
    await new Promise((done) => setTimeout(done, 150)); // what is still on its way to the recorder
    this.recorder.stop();
    await finished;
    player.recording = false;
    if (this.output) player.gain.disconnect(this.output);
    return this.cancelled ? null : new Blob(this.chunks, { type: this.type });
  }

  cancel() { this.cancelled = true; }
}
