// The weights of ARKit's shapes over time, the liveliest first.

const ROW = 30;

class CurveList {
  constructor(canvas, player, colors) {
    this.canvas = canvas;
    this.player = player;
    this.colors = colors;
    this.rows = [];
    canvas.addEventListener("pointerdown", (event) => {
      const box = canvas.getBoundingClientRect();
      const share = (event.clientX - box.left - this.graphLeft(box.width)) / (box.width - this.graphLeft(box.width));
      if (this.take && share >= 0) player.seek(share * this.take.motionSeconds);
    });
  }

  graphLeft(width) { return Math.min(150, width * 0.45); }

  show(take, filter = "") {
    this.take = take;
    const names = take?.header.curves || [];
    this.rows = names
      .map((name, index) => {
        const values = take.curves.subarray(index * take.frames, (index + 1) * take.frames);
        return { name, values, largest: values.reduce((a, b) => Math.max(a, b), 0) };
      })
      .filter(({ name }) => name.toLowerCase().includes(filter.toLowerCase()))
      .sort((a, b) => b.largest - a.largest);
    this.canvas.style.height = `${Math.max(1, this.rows.length) * ROW}px`;
  }

  draw() {
    const { canvas, take } = this, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) return;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d"), colors = this.colors();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (!take) return;
    const left = this.graphLeft(width), graph = width - left;
    const frame = clamp(Math.round(this.player.time() * take.fps), 0, take.frames - 1);
    const now = left + (graph * frame) / Math.max(take.frames - 1, 1);
    context.textBaseline = "middle";
    this.rows.forEach(({ name, values }, row) => {
      const top = row * ROW, middle = top + ROW / 2;
      context.font = "12px system-ui, sans-serif";
      context.fillStyle = values[frame] > 12 ? colors.text : colors.muted;
      context.textAlign = "left";
      context.fillText(name, 0, middle - 4, left - 8);
      context.fillStyle = colors.line;
      context.fillRect(0, middle + 7, left - 12, 3);
      context.fillStyle = colors.accent;
      context.fillRect(0, middle + 7, ((left - 12) * values[frame]) / 255, 3);
      context.strokeStyle = colors.wave;
      context.lineWidth = 1.5;
      context.beginPath();
      for (let x = 0; x <= graph; x += 2) {
        const value = values[Math.min(take.frames - 1, Math.round((x / graph) * (take.frames - 1)))] / 255;
        context.lineTo(left + x, top + ROW - 5 - value * (ROW - 10));
      }
      context.stroke();
    });
    context.fillStyle = colors.accent;
    context.fillRect(now - 0.75, 0, 1.5, height);
  }
}
