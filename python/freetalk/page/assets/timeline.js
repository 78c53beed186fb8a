// The waveform to click into: where the speech is, what is heard, what is repeated.

const PHONE_LANE = 16;

class Timeline {
  constructor(canvas, player, colors) {
    this.canvas = canvas;
    this.player = player;
    this.colors = colors;
    this.take = null;
    this.peaks = null;
    this.hover = null;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerleave", () => { this.hover = null; this.draw(); });
    canvas.addEventListener("dblclick", () => this.player.setRegion(null));
  }

  show(take) {
    this.take = take;
    this.peaks = null;
  }

  secondsAt(event) {
    const box = this.canvas.getBoundingClientRect();
    return clamp((event.clientX - box.left) / box.width, 0, 1) * this.player.duration;
  }

  down(event) {
    if (!this.take || event.button > 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.from = this.secondsAt(event);
    this.selecting = event.shiftKey;
    if (!this.selecting) this.player.seek(this.from);
  }

  move(event) {
    if (!this.take) return;
    this.hover = this.secondsAt(event);
    if (event.buttons & 1 && this.canvas.hasPointerCapture(event.pointerId)) {
      if (this.selecting) this.player.setRegion([Math.min(this.from, this.hover), Math.max(this.from, this.hover)]);
      else this.player.seek(this.hover);
    }
    this.draw();
  }

  draw() {
    const { canvas, player, take } = this, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      this.peaks = null;
    }
    const context = canvas.getContext("2d"), colors = this.colors();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!take || player.duration === 0) return;
    const x = (seconds) => (seconds / player.duration) * width;
    const phones = take.header.phones;
    const bottom = height - (phones.length ? PHONE_LANE : 0);
    if (player.region) {
      context.fillStyle = colors.region;
      context.fillRect(x(player.start), 0, Math.max(x(player.end) - x(player.start), 1), height);
    }
    this.drawSound(context, colors, width, bottom, x(player.time()));
    if (phones.length) this.drawPhones(context, colors, x, bottom);
    context.fillStyle = colors.accent;
    context.fillRect(x(player.time()) - 1, 0, 2, height);
    if (this.hover !== null) {
      context.fillStyle = colors.muted;
      context.fillRect(x(this.hover), 0, 1, height);
      this.drawLabel(context, colors, clockText(this.hover), x(this.hover), width);
    }
  }

  drawSound(context, colors, width, height, played) {
    const bars = Math.max(1, Math.floor(width / 3));
    this.peaks ||= this.take.peaks(bars, this.player.duration);
    const { low, high } = this.peaks, middle = height / 2;
    const loudest = Math.max(0.05, ...high, ...low.map((v) => -v));
    for (let i = 0; i < bars; ++i) {
      const x = (i * width) / bars;
      const up = (high[i] / loudest) * (middle - 3), down = (-low[i] / loudest) * (middle - 3);
      context.fillStyle = x < played ? colors.accent : colors.wave;
      context.fillRect(x, middle - up - 0.5, 2, up + down + 1);
    }
  }

  drawPhones(context, colors, x, top) {
    context.font = "10px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const [start, end, label] of this.take.header.phones) {
      const left = x(start), width = x(end) - left;
      context.fillStyle = colors.line;
      context.fillRect(left, top, 1, PHONE_LANE);
      context.fillStyle = colors.muted;
      if (width > context.measureText(label).width + 2) context.fillText(label, left + width / 2, top + PHONE_LANE / 2);
    }
  }

  drawLabel(context, colors, text, x, width) {
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "left";
    context.textBaseline = "top";
    const wide = context.measureText(text).width + 10;
    const left = clamp(x + 6, 0, width - wide);
    context.fillStyle = colors.panel;
    context.fillRect(left, 2, wide, 17);
    context.fillStyle = colors.text;
    context.fillText(text, left + 5, 5);
  }
}
