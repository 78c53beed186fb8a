// What the person sees and does: takes, panes, settings, keys.

const MOST_PANES = 4;
const SMOOTH = 26; // pictures a second below which the drawing gets coarser while it plays
const LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ";
const element = (id) => document.getElementById(id);
const icon = (button, name) => button.querySelector("use").setAttribute("href", `#i-${name}`);

class App {
  /** Further tabs come before those that every page has. */
  constructor(settings, tabs = []) {
    this.settings = settings;
    this.takes = [];
    this.shown = [];
    this.heard = null;
    this.truth = null;
    this.look = { surface: "skin", wireframe: false, landmarks: false, truth: null, largestMm: 2, wireColor: [0, 0, 0, 0.35] };
    this.scene = new Scene(element("view"));
    this.player = new Player(() => this.changed());
    const colors = () => this.colors;
    this.timeline = new Timeline(element("timeline"), this.player, colors);
    this.curves = new CurveList(element("curves"), this.player, colors);
    this.composer = new Composer(element("view"));
    this.frameTimes = []; // of the last second
    this.judgedAt = null; // when the speed of drawing was last judged
    this.dirty = true;
    element("title").textContent = settings.title;
    this.setTheme(this.storedTheme());
    this.drawScale();
    for (const [name, text] of [...tabs, ["view", "View"], ["shapes", "Shapes"], ["about", "About"]]) this.addTab(name, text);
    this.openTab(tabs.length ? tabs[0][0] : "view");
    this.connectControls();
    this.connectView();
    document.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.refresh()).observe(element("stage"));
    if (matchMedia("(max-width: 760px)").matches) this.togglePanel(false);
    this.changed();
    requestAnimationFrame(() => this.frame());
  }

  // ---- takes ----

  add(take) {
    this.takes.push(take);
    take.letter = [...LETTERS].find((letter) => this.takes.every((other) => other.letter !== letter)) || "+";
    this.listTakes();
  }

  remove(take) {
    this.takes.splice(this.takes.indexOf(take), 1);
    this.scene.surfaces.delete(take);
    this.player.buffers.delete(take);
    if (this.look.truth === take) this.setTruth(null);
    this.show(this.shown.filter((other) => other !== take));
  }

  listTakes() {
    const nav = element("takes");
    nav.replaceChildren();
    if (this.takes.length > 1) {
      this.takes.forEach((take, index) => {
        const chip = document.createElement("button");
        chip.className = "chip";
        chip.title = index < 9 ? `${take.name} (${index + 1})` : take.name;
        chip.setAttribute("aria-pressed", String(this.shown.includes(take)));
        chip.append(Object.assign(document.createElement("b"), { textContent: take.letter }), Object.assign(document.createElement("span"), { textContent: take.name }));
        chip.addEventListener("click", () => this.toggle(take));
        nav.append(chip);
      });
    }
    const same = this.takes.filter((take) => this.takes.some((other) => other !== take && take.matches(other)));
    element("errors").hidden = same.length === 0;
    const truth = element("truth");
    truth.replaceChildren(new Option("nothing", ""), ...same.map((take) => new Option(`${take.letter} · ${take.name}`, take.id)));
    truth.value = this.look.truth ? this.look.truth.id : "";
    const kinds = [["skin", this.takes.some((t) => t.header.painted) ? "Colours" : "Skin"], ["clay", "Clay"]];
    if (this.takes.some((take) => take.picture)) kinds.unshift(["texture", "Texture"]);
    const surface = element("surface");
    surface.replaceChildren(...kinds.map(([kind, text]) => {
      const button = Object.assign(document.createElement("button"), { textContent: text });
      button.setAttribute("role", "radio");
      button.dataset.kind = kind;
      button.addEventListener("click", () => this.setSurface(kind));
      return button;
    }));
    this.markSurface();
    element("landmarks-row").hidden = !this.takes.some((take) => take.landmarks);
    element("tab-shapes-button").hidden = !this.takes.some((take) => take.curves);
  }

  /** Shows these takes, at most four, and hears the first of them unless another of them is heard. */
  show(takes) {
    this.shown = takes.slice(0, MOST_PANES).sort((a, b) => this.takes.indexOf(a) - this.takes.indexOf(b));
    if (!this.shown.includes(this.heard)) this.heard = this.shown[0] || null;
    element("empty").hidden = this.shown.length > 0;
    this.hear(this.heard);
  }

  toggle(take) {
    if (!this.shown.includes(take)) this.show([...this.shown.slice(-(MOST_PANES - 1)), take]);
    else if (this.shown.length > 1) this.show(this.shown.filter((other) => other !== take));
  }

  hear(take) {
    this.heard = take;
    this.player.use(take, Math.max(0, ...this.shown.map((one) => one.duration)));
    this.timeline.show(take);
    this.curves.show(take, element("filter").value);
    this.listTakes();
    this.listFacts();
    this.layout();
    this.changed();
  }

  /** Panes: one, up to three beside each other, or two by two. */
  layout() {
    const stage = element("stage"), count = this.shown.length;
    const wide = stage.clientWidth > stage.clientHeight;
    const columns = count < 2 || (count === 2 && !wide) ? 1 : count === 3 && wide ? 3 : 2, rows = Math.ceil(count / columns) || 1;
    this.panes = this.shown.map((take, i) => ({ take, box: [(i % columns) / columns, Math.floor(i / columns) / rows, 1 / columns, 1 / rows] }));
    element("labels").replaceChildren(...this.panes.map(({ take, box }, i) => {
      const pane = document.createElement("div");
      pane.className = "pane";
      const [x, y, w, h] = box.map((share) => `${100 * share}%`);
      Object.assign(pane.style, { left: x, top: y, width: w, height: h, borderLeftWidth: box[0] ? "1px" : 0, borderTopWidth: box[1] ? "1px" : 0 });
      if (count > 1 || this.look.truth) {
        const button = document.createElement("button");
        button.title = "Hear this take";
        button.classList.toggle("heard", take === this.heard && count > 1);
        button.append(Object.assign(document.createElement("span"), { textContent: `${take.letter} · ${take.name}` }), document.createElement("small"));
        button.addEventListener("click", () => this.hear(take));
        pane.append(button);
      }
      return pane;
    }));
    this.refresh();
  }

  listFacts() {
    const take = this.heard, list = element("facts");
    list.replaceChildren();
    if (!take) return;
    const facts = {
      Take: take.name, ...take.header.facts,
      Length: `${take.motionSeconds.toFixed(2)} s, ${take.frames} frames at ${+take.fps.toFixed(3)} a second`,
      Mesh: `${take.vertices.toLocaleString("en")} vertices, ${(take.faces.length / 3).toLocaleString("en")} triangles`,
      "Motion in this page": `${take.numTargets} components, within ${take.header.error_mm.toFixed(3)} mm of the original`,
    };
    for (const [label, text] of Object.entries(facts)) {
      list.append(Object.assign(document.createElement("dt"), { textContent: label }), Object.assign(document.createElement("dd"), { textContent: text }));
    }
    this.rateText = Object.assign(document.createElement("dd"), { textContent: "plays when you press play" });
    list.append(Object.assign(document.createElement("dt"), { textContent: "Pictures a second" }), this.rateText);
  }

  // ---- look ----

  setSurface(kind) {
    this.look.surface = kind;
    this.markSurface();
    this.refresh();
  }

  markSurface() {
    for (const button of element("surface").children) {
      const on = button.dataset.kind === this.look.surface;
      button.setAttribute("aria-checked", String(on));
      button.tabIndex = on ? 0 : -1;
    }
  }

  setTruth(take) {
    this.look.truth = take;
    if (take) this.fitLargest(take);
    element("truth").value = take ? take.id : "";
    element("largest-row").hidden = element("legend").hidden = !take;
    this.layout();
  }

  /** Full colour at the largest distance there is now. */
  fitLargest(truth) {
    const at = this.shownAt ?? 0, others = this.shown.filter((take) => take !== truth && take.matches(truth));
    truth.moveTo(at);
    const largest = Math.max(0, ...others.map((take) => {
      take.moveTo(at);
      return take.errors(truth, new Float32Array(take.vertices)).largest;
    }));
    if (largest > 0) element("largest").value = Math.log10(largest);
    this.setLargest(Number(element("largest").value));
  }

  setLargest(exponent) {
    const mm = 10 ** exponent;
    this.look.largestMm = Number(mm.toPrecision(2));
    element("largest-text").textContent = `${this.look.largestMm} mm`;
    element("scale-text").replaceChildren(...["0", `${this.look.largestMm} mm`].map((text) => Object.assign(document.createElement("span"), { textContent: text })));
    this.refresh();
  }

  drawScale() {
    const context = element("scale").getContext("2d"), image = context.createImageData(256, 1);
    const of = (c, x) => clamp(c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5])))), 0, 1) * 255;
    for (let i = 0; i < 256; ++i) {
      const x = i / 255;
      image.data.set([
        of([0.13572138, 4.6153926, -42.66032258, 132.13108234, -152.94239396, 59.28637943], x),
        of([0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604], x),
        of([0.1066733, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973], x), 255,
      ], 4 * i);
    }
    context.putImageData(image, 0, 0);
  }

  storedTheme() {
    try {
      const kept = localStorage.getItem("freetalk-theme");
      if (kept) return kept;
    } catch { /* a page from disk may have no storage */ }
    return matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  }

  setTheme(theme) {
    document.documentElement.dataset.theme = theme;
    try { localStorage.setItem("freetalk-theme", theme); } catch { /* as above */ }
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(`--${name}`).trim();
    this.colors = Object.fromEntries(["accent", "wave", "line", "muted", "text", "panel", "region"].map((name) => [name, read(name)]));
    const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
    this.scene.backdrop = { top: rgb(read("stage-top")), bottom: rgb(read("stage-bottom")) };
    this.refresh();
  }

  togglePanel(open = element("app").classList.contains("closed")) {
    element("app").classList.toggle("closed", !open);
    element("panel").hidden = !open;
    element("panel-toggle").setAttribute("aria-expanded", String(open));
    this.refresh();
  }

  addTab(name, text) {
    const button = Object.assign(document.createElement("button"), { id: `tab-${name}-button`, textContent: text });
    button.setAttribute("role", "tab");
    button.setAttribute("aria-controls", `tab-${name}`);
    button.addEventListener("click", () => this.openTab(name));
    element("tabs").append(button);
  }

  openTab(name) {
    for (const button of element("tabs").children) {
      const on = button.id === `tab-${name}-button`;
      button.setAttribute("aria-selected", String(on));
      element(button.getAttribute("aria-controls")).hidden = !on;
    }
    this.refresh();
  }

  // ---- controls ----

  connectControls() {
    const on = (id, kind, action) => element(id).addEventListener(kind, action);
    on("play", "click", () => this.player.toggle());
    on("loop", "click", () => this.setLoop(!this.player.loop));
    on("mute", "click", () => this.player.setMuted(!this.player.muted));
    on("front", "click", () => this.lookFromFront());
    on("picture", "click", () => this.savePicture());
    on("film", "click", () => this.saveFilm());
    on("theme", "click", () => this.switchTheme());
    on("help", "click", () => element("keys").showModal());
    on("panel-toggle", "click", () => this.togglePanel());
    on("wireframe", "change", (event) => this.setLook("wireframe", event.target.checked));
    on("landmarks", "change", (event) => this.setLook("landmarks", event.target.checked));
    on("truth", "change", (event) => this.setTruth(this.takes.find((take) => take.id === event.target.value) || null));
    on("largest", "input", (event) => this.setLargest(Number(event.target.value)));
    on("filter", "input", (event) => { this.curves.show(this.heard, event.target.value); this.refresh(); });
    element("speed").append(...RATES.map((rate) => new Option(`${rate} ×`, rate)));
    element("speed").value = 1;
    on("speed", "change", (event) => this.player.setRate(Number(event.target.value)));
    // A button that was clicked does not keep the space bar to itself.
    document.addEventListener("click", (event) => { if (event.detail > 0) event.target.closest("button, input[type=checkbox]")?.blur(); });
    on("surface", "keydown", (event) => {
      if (event.key.startsWith("Arrow")) { this.nextSurface(); element("surface").querySelector("[aria-checked=true]").focus(); event.stopPropagation(); event.preventDefault(); }
    });
    this.setLargest(Number(element("largest").value));
    this.setTruth(null);
  }

  setLook(name, value) {
    this.look[name] = value;
    element(name).checked = value;
    this.refresh();
  }

  setLoop(loop) {
    this.player.loop = loop;
    this.changed();
  }

  switchTheme() { this.setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light"); }

  nextSurface() {
    const kinds = [...element("surface").children].map((button) => button.dataset.kind);
    this.setSurface(kinds[(kinds.indexOf(this.look.surface) + 1) % kinds.length]);
  }

  lookFromFront() {
    const { camera } = this.scene;
    const fromFront = Math.abs(camera.yaw) < 1e-3 && camera.zoom === 1 && !camera.shift[0] && !camera.shift[1];
    camera.reset(fromFront ? Math.PI / 2 : 0, 0);
    this.refresh();
  }

  connectView() {
    const view = element("view"), { camera } = this.scene, fingers = new Map();
    const metres = (pixels) => (pixels / view.clientHeight) * (this.heard?.header.framing.extent[1] || 0.2) * 1.2 / camera.zoom;
    view.addEventListener("pointerdown", (event) => {
      view.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    view.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = [event.clientX, event.clientY], dx = now[0] - before[0], dy = now[1] - before[1];
      if (fingers.size === 2) {
        const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
        const span = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]);
        camera.scale(span(now) / Math.max(span(before), 1));
        this.moveFace(metres(dx / 2), metres(dy / 2));
      } else if (event.shiftKey || event.buttons & 6) this.moveFace(metres(dx), metres(dy));
      else camera.turn(dx / 180, dy / 180);
      fingers.set(event.pointerId, now);
      this.refresh();
    });
    for (const kind of ["pointerup", "pointercancel"]) view.addEventListener(kind, (event) => fingers.delete(event.pointerId));
    view.addEventListener("wheel", (event) => {
      event.preventDefault();
      camera.scale(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)));
      this.refresh();
    }, { passive: false });
    view.addEventListener("contextmenu", (event) => event.preventDefault());
    view.addEventListener("dblclick", () => { camera.reset(); this.refresh(); });
    view.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.fail("The graphics card stopped drawing. Load the page again.");
    });
  }

  moveFace(dx, dy) {
    const { shift } = this.scene.camera;
    shift[0] += dx;
    shift[1] -= dy;
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || element("keys").open) return;
    const typing = event.target.closest("input:not([type=checkbox]), select, textarea");
    if (typing && !(typing.type === "range" && event.key === " ")) return;
    if (event.target.closest("button, input[type=checkbox]") && [" ", "Enter"].includes(event.key)) return;
    const { player } = this, step = event.shiftKey ? 1 : 1 / (this.heard?.fps || 30);
    const digit = /^Digit(\d)$/.exec(event.code);
    const actions = {
      " ": () => player.toggle(), ArrowLeft: () => this.step(-step), ArrowRight: () => this.step(step),
      Home: () => player.seek(player.start), End: () => player.seek(player.end),
      "[": () => player.setRegion([player.time(), player.region ? player.end : player.duration]),
      "]": () => player.setRegion([player.start, player.time()]), "\\": () => player.setRegion(null),
      "<": () => this.changeSpeed(-1), ">": () => this.changeSpeed(1), l: () => this.setLoop(!player.loop),
      m: () => player.setMuted(!player.muted), c: () => this.nextSurface(), r: () => this.lookFromFront(),
      w: () => this.setLook("wireframe", !this.look.wireframe), p: () => this.savePicture(), v: () => this.saveFilm(),
      k: () => this.setLook("landmarks", !this.look.landmarks), t: () => this.switchTheme(), b: () => this.togglePanel(),
      "?": () => element("keys").showModal(),
    };
    const action = digit && this.takes.length > 1 ? () => this.pick(Number(digit[1]), event.shiftKey) : actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  step(seconds) {
    this.player.pause();
    const { fps } = this.heard || { fps: 30 };
    this.player.seek(Math.round((this.player.time() + seconds) * fps) / fps);
  }

  pick(digit, beside) {
    if (digit === 0) this.show(this.takes);
    else if (this.takes[digit - 1]) beside ? this.toggle(this.takes[digit - 1]) : this.show([this.takes[digit - 1]]);
  }

  changeSpeed(by) {
    const rate = RATES[clamp(RATES.indexOf(this.player.rate) + by, 0, RATES.length - 1)];
    element("speed").value = rate;
    this.player.setRate(rate);
  }

  // ---- saving ----

  legendPicture() {
    return this.look.truth ? { image: element("scale"), text: `0 to ${this.look.largestMm} mm from ${this.look.truth.letter}` } : null;
  }

  compose() {
    this.drawStage();
    const labels = this.shown.length > 1 ? this.shown.map((take) => `${take.letter} · ${take.name}`) : [];
    return this.composer.compose(this.panes, labels, this.legendPicture());
  }

  savePicture() {
    if (!this.heard) return;
    this.compose().toBlob((blob) => download(blob, `${fileName(this.settings.title)}_${this.player.time().toFixed(2)}s.png`));
    this.say("The picture is among your downloads.");
  }

  async saveFilm() {
    if (!this.heard) return;
    if (this.film) return this.film.cancel();
    const button = element("film");
    try {
      this.compose();
      this.film = new Film(this.player, this.composer.canvas, 30);
      button.setAttribute("aria-pressed", "true");
      this.say("Recording one pass from the start …", { text: "Stop", action: () => this.film?.cancel() });
      const blob = await this.film.run();
      if (blob) download(blob, `${fileName(this.settings.title)}.${this.film.ending}`);
      this.say(blob ? "The video is among your downloads." : "Nothing was saved.");
    } catch (error) {
      this.say(error.message);
    } finally {
      this.film = null;
      button.removeAttribute("aria-pressed");
    }
  }

  say(text, offer = null, stays = offer !== null) {
    const notice = element("notice");
    notice.replaceChildren(text);
    if (offer) {
      const button = Object.assign(document.createElement("button"), { textContent: offer.text });
      button.addEventListener("click", offer.action);
      notice.append(button);
    }
    notice.hidden = false;
    clearTimeout(this.noticeTimer);
    if (!stays) this.noticeTimer = setTimeout(() => (notice.hidden = true), 3500);
  }

  fail(text) {
    const empty = element("empty");
    empty.classList.add("failed");
    empty.hidden = false;
    element("empty-text").textContent = text;
  }

  // ---- drawing ----

  refresh() { this.dirty = true; }

  /** Something of the player changed: its buttons follow. */
  changed() {
    const { player } = this;
    icon(element("play"), player.playing ? "pause" : "play");
    element("play").setAttribute("aria-label", player.playing ? "Pause" : "Play");
    element("play").disabled = !this.heard;
    element("loop").setAttribute("aria-pressed", String(player.loop));
    element("mute").setAttribute("aria-pressed", String(player.muted));
    icon(element("mute"), player.muted ? "muted" : "sound");
    this.refresh();
  }

  frame() {
    requestAnimationFrame(() => this.frame());
    const now = performance.now(), at = this.player.tick();
    if (this.player.playing) {
      this.frameTimes.push(now);
      while (this.frameTimes[0] < now - 1000) this.frameTimes.shift();
      if (this.rateText) this.rateText.textContent = String(this.frameTimes.length);
      this.adaptQuality(now);
    } else if (this.frameTimes.length) {
      this.frameTimes.length = 0;
      this.judgedAt = null;
      this.scene.quality = 1;
      this.scene.smooth = true;
      this.dirty = true;
    }
    if (!this.dirty && !this.player.playing) return;
    this.dirty = false;
    this.shownAt = at;
    if (this.film) this.compose();
    else this.drawStage();
    this.busyMs = performance.now() - now;
    this.timeline.draw();
    if (!element("tab-shapes").hidden) this.curves.draw();
    const text = `${clockText(at)} / ${clockText(this.player.duration)}`;
    element("time").textContent = text;
    const slider = element("timeline");
    slider.setAttribute("aria-valuemax", this.player.duration.toFixed(2));
    slider.setAttribute("aria-valuenow", at.toFixed(2));
    slider.setAttribute("aria-valuetext", text);
  }

  /** A machine without a graphics card draws fewer samples and pixels while it plays, all of them when it stands still. */
  adaptQuality(now) {
    if (this.film || (this.judgedAt !== null && now - this.judgedAt < 1000)) return;
    const first = this.judgedAt === null;
    this.judgedAt = now;
    if (first || this.frameTimes.length >= SMOOTH) return;
    if (this.scene.smooth) this.scene.smooth = false;
    else this.scene.quality = Math.max(0.4, this.scene.quality * Math.sqrt(Math.max(0.25, this.frameTimes.length / SMOOTH)));
  }

  drawStage() {
    const { scene, look } = this, at = this.shownAt ?? 0;
    if (scene.resize()) this.layout();
    const light = document.documentElement.dataset.theme === "light";
    look.wireColor = look.truth || light ? [0, 0, 0, 0.3] : [0.02, 0.05, 0.08, 0.42];
    if (look.truth) look.truth.moveTo(at);
    this.shown.forEach((take, i) => {
      const moved = take.moveTo(at), surface = scene.surface(take);
      if (moved || surface.placed !== take.shown) surface.place();
      surface.placed = take.shown;
      if (look.truth && look.truth !== take && take.matches(look.truth)) {
        const { mean, largest } = surface.compare(look.truth);
        const note = element("labels").children[i]?.querySelector("small");
        if (note) note.textContent = `${mean.toFixed(2)} mm, at most ${largest.toFixed(2)}`;
      }
    });
    scene.draw(this.panes || [], look);
  }

  /** What is going on, for scripts that drive the page. */
  status() {
    const { player } = this;
    return {
      ready: this.shown.length > 0, playing: player.playing, audible: Boolean(player.audible), time: player.time(), shown: this.shownAt ?? 0,
      pictures: this.frameTimes.length, quality: this.scene.quality, busyMs: this.busyMs, takes: this.takes.map((take) => take.name), panes: this.shown.map((take) => take.letter),
      heard: this.heard?.letter ?? null, surface: this.look.surface, truth: this.look.truth?.letter ?? null,
    };
  }
}
