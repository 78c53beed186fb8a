// The emotion: a point between the names around a neutral middle, and points like it over time.

const AROUND = [
  "happy", "surprise", "afraid", "upset", "angry", "contempt", "disgust", "suspicious", "ill", "ashamed", "sad", "drunk", "pleased",
];
const RIM = 0.33; // where the names begin, as a share of the pad's width

class EmotionPad {
  constructor(onchange) {
    this.onchange = onchange;
    this.names = [];
    this.keys = [{ time: 0, x: 0, y: 0, intensity: 2 }]; // x, y in the unit disc
    this.chosen = this.keys[0];
    this.duration = 0;
    const pad = element("pad");
    pad.addEventListener("pointerdown", (event) => { pad.setPointerCapture(event.pointerId); this.drag(event); });
    pad.addEventListener("pointermove", (event) => { if (event.buttons & 1) this.drag(event); });
    pad.addEventListener("keydown", (event) => this.nudge(event));
    element("intensity").addEventListener("input", (event) => { this.chosen.intensity = Number(event.target.value); this.draw(); this.onchange(); });
    element("remove-key").addEventListener("click", () => this.remove(this.chosen));
  }

  /** Names of the weights in use. */
  setNames(names, most) {
    const others = names.filter((name) => name !== "neutral");
    this.names = [...AROUND.filter((name) => others.includes(name)), ...others.filter((name) => !AROUND.includes(name))];
    element("intensity").max = most;
    const pad = element("pad");
    for (const label of pad.querySelectorAll("span")) label.remove();
    this.names.forEach((name, i) => {
      const angle = (2 * Math.PI * i) / this.names.length - Math.PI / 2;
      const label = Object.assign(document.createElement("span"), { textContent: name });
      label.style.left = `${50 + 42 * Math.cos(angle)}%`;
      label.style.top = `${50 + 43 * Math.sin(angle)}%`;
      pad.append(label);
    });
    this.draw();
  }

  setDuration(seconds) {
    this.duration = seconds;
    for (const key of this.keys) key.time = Math.min(key.time, seconds);
    this.draw();
  }

  drag(event) {
    const box = element("pad").getBoundingClientRect(), radius = RIM * box.width;
    this.place((event.clientX - box.left - box.width / 2) / radius, (event.clientY - box.top - box.height / 2) / radius);
  }

  nudge(event) {
    const [dx, dy] = { ArrowLeft: [-0.08, 0], ArrowRight: [0.08, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08] }[event.key] || [0, 0];
    if (!dx && !dy) return;
    event.preventDefault();
    event.stopPropagation();
    this.place(this.chosen.x + dx, this.chosen.y + dy);
  }

  place(x, y) {
    const length = Math.max(1, Math.hypot(x, y));
    this.chosen.x = x / length;
    this.chosen.y = y / length;
    if (Math.hypot(this.chosen.x, this.chosen.y) < 0.08) this.chosen.x = this.chosen.y = 0;
    this.draw();
    this.onchange();
  }

  /** Shares of a key's emotions by name: the two names it lies between, the rest neutral. */
  mixture(key) {
    const far = Math.min(1, Math.hypot(key.x, key.y)), count = this.names.length, shares = new Map();
    if (far < 1) shares.set("neutral", 1 - far);
    if (far > 0 && count) {
      const turn = ((Math.atan2(key.y, key.x) + Math.PI / 2) / (2 * Math.PI) + 1) * count;
      const first = Math.floor(turn) % count, share = turn - Math.floor(turn);
      for (const [name, part] of [[this.names[first], 1 - share], [this.names[(first + 1) % count], share]])
        shares.set(name, (shares.get(name) || 0) + far * part);
    }
    const kept = [...shares].filter(([, share]) => share >= 0.04).sort((a, b) => b[1] - a[1]);
    const sum = kept.reduce((all, [, share]) => all + share, 0);
    return new Map(kept.map(([name, share]) => [name, share / sum]));
  }

  textOf(key) {
    return [...this.mixture(key)].map(([name, share]) => `${name}:${share.toFixed(2)}`).join(",");
  }

  /** What the talker understands. */
  wish() {
    if (this.keys.length === 1) return { emotion: this.textOf(this.keys[0]), intensity: this.keys[0].intensity };
    return { emotion: this.keys.map((key) => `${key.time.toFixed(2)}=${this.textOf(key)}@${key.intensity.toFixed(1)}`).join("; ") };
  }

  /** The chosen emotion alone, for live speech. */
  now() { return { emotion: this.textOf(this.chosen), intensity: this.chosen.intensity }; }

  addAt(time) {
    const near = this.keys.find((key) => Math.abs(key.time - time) < 0.1);
    if (near) { this.choose(near); return; }
    const key = { ...this.chosen, time };
    this.keys.push(key);
    this.keys.sort((a, b) => a.time - b.time);
    this.choose(key);
  }

  remove(key) {
    if (this.keys.length === 1 || key === this.keys[0]) return;
    this.keys.splice(this.keys.indexOf(key), 1);
    this.choose(this.keys[0]);
  }

  choose(key) {
    this.chosen = key;
    this.draw();
    this.onchange();
  }

  draw() {
    const { chosen } = this, mixture = this.mixture(chosen), pad = element("pad");
    const aspect = pad.clientWidth / Math.max(pad.clientHeight, 1);
    element("puck").style.left = `${50 + 100 * RIM * chosen.x}%`;
    element("puck").style.top = `${50 + 100 * RIM * aspect * chosen.y}%`;
    for (const label of pad.querySelectorAll("span")) label.classList.toggle("on", mixture.has(label.textContent));
    element("mixture").textContent = [...mixture].map(([name, share]) => `${name} ${Math.round(100 * share)} %`).join(" · ");
    element("intensity").value = chosen.intensity;
    element("intensity-text").textContent = chosen.intensity.toFixed(1);
    element("remove-key").disabled = chosen === this.keys[0];
    element("lane").hidden = element("add-key").parentElement.hidden = this.duration === 0;
    element("lane").replaceChildren(...this.keys.map((key) => this.knob(key)));
  }

  knob(key) {
    const knob = document.createElement("button");
    knob.style.left = `${(100 * key.time) / Math.max(this.duration, 1e-6)}%`;
    knob.setAttribute("aria-pressed", String(key === this.chosen));
    knob.setAttribute("aria-label", `${clockText(key.time)}: ${[...this.mixture(key).keys()].join(" and ")}`);
    knob.title = knob.getAttribute("aria-label");
    knob.addEventListener("pointerdown", (event) => {
      const lane = element("lane").getBoundingClientRect();
      this.choose(key);
      if (key === this.keys[0]) return; // the first holds from the start
      const move = (at) => {
        key.time = clamp((at.clientX - lane.left) / lane.width, 0.01, 1) * this.duration;
        this.keys.sort((a, b) => a.time - b.time);
        this.draw();
      };
      const up = () => { removeEventListener("pointermove", move); this.onchange(); };
      addEventListener("pointermove", move);
      addEventListener("pointerup", up, { once: true });
      event.preventDefault();
    });
    knob.addEventListener("keydown", (event) => {
      if (event.key === "Delete" || event.key === "Backspace") this.remove(key);
      else if (event.key === "Enter" || event.key === " ") this.choose(key);
    });
    return knob;
  }
}
