// The page with a server behind it: what is dropped, made, kept and spoken.

const CLIENT = Array.from(crypto.getRandomValues(new Uint8Array(8)), (byte) => byte.toString(16).padStart(2, "0")).join("");
const BASE = location.pathname.replace(/[^/]*$/, "");

async function ask(path, method = "GET", body = undefined, query = {}) {
  const json = body !== undefined && !(body instanceof Blob);
  let answer;
  try {
    answer = await fetch(`${BASE}${path}?${new URLSearchParams({ client: CLIENT, ...query })}`, { method, body: json ? JSON.stringify(body) : body });
  } catch {
    throw new Error("The server does not answer. Is it still running?");
  }
  if (!answer.ok) throw new Error((await answer.json().catch(() => ({}))).error || `The server refused (${answer.status}).`);
  return answer;
}

class StudioPage {
  constructor(app) {
    this.app = app;
    this.known = new Map(); // id of a take -> Take, or null while it is on its way
    this.saving = new Map(); // id of a job -> what happens when its file is there
    this.state = null;
    this.pad = new EmotionPad(() => this.live?.running && this.live.direct(this.pad.now()));
    const on = (id, kind, action) => element(id).addEventListener(kind, (event) => this.attempt(() => action(event)));
    on("choose-sound", "click", () => element("sound-file").click());
    on("choose-mesh", "click", () => element("mesh-file").click());
    on("sound-file", "change", (event) => this.addFiles(event.target.files));
    on("mesh-file", "change", (event) => this.addFiles(event.target.files));
    on("record", "click", () => this.record());
    on("mark-face", "click", () => this.markFace());
    for (const kind of ["mesh", "sound"]) on(`remove-${kind}`, "click", () => this.remove(kind));
    on("sound", "change", () => this.soundChosen());
    on("add-key", "click", () => this.pad.addAt(Math.min(this.app.player.time(), this.pad.duration)));
    on("dice", "click", () => (element("seed").value = Math.floor(Math.random() * 1e6)));
    for (const name of ["freedom", "articulation"]) {
      on(name, "input", () => this.showNumber(name));
      this.showNumber(name);
    }
    on("generate", "click", () => this.generate());
    on("live-start", "click", () => this.toggleLive());
    on("live-hear", "change", (event) => this.live?.running && this.live.hear(event.target.checked));
    this.connectDrops();
  }

  async attempt(action) {
    try {
      await action();
    } catch (error) {
      this.app.say(error.message);
    }
  }

  showNumber(name) { element(`${name}-text`).textContent = Number(element(name).value).toFixed(2); }

  // ---- what the server says ----

  async run() {
    for (;;) {
      await this.attempt(() => this.update());
      const busy = this.state?.jobs.some((job) => job.client === CLIENT && ["waiting", "running"].includes(job.state));
      await new Promise((done) => { this.wake = done; setTimeout(done, busy ? 400 : 5000); });
    }
  }

  async update() {
    const state = await (await ask("state")).json();
    const first = this.state === null;
    this.state = state;
    if (first) {
      this.pad.setNames(state.emotions, state.max_intensity);
      element("mesh-file").accept = state.mesh_suffixes.join(",");
    }
    this.list("mesh", state.meshes, (mesh) => `${mesh.name} · ${mesh.vertices.toLocaleString("en")} vertices${mesh.marked ? ", marked" : ""}`, "");
    this.list("sound", state.sounds, (sound) => `${sound.name} · ${clockText(sound.seconds)}`, "nothing yet");
    element("generate").disabled = element("remove-sound").disabled = state.sounds.length === 0;
    element("remove-mesh").disabled = state.meshes.length === 1;
    this.soundChosen();
    this.listJobs();
    await this.loadTakes();
    this.listTakes();
    if (this.app.shown.length === 0 && !this.live?.running) this.invite();
    for (const job of state.jobs) this.finish(job);
  }

  list(id, items, text, empty) {
    const select = element(id), before = select.value, ids = items.map((item) => item.id), key = items.map(text).join() + ids;
    if (key === select.dataset.key) return;
    select.dataset.key = key;
    const added = items.length > select.options.length && items.at(-1);
    select.replaceChildren(...items.map((item) => new Option(text(item), item.id)));
    if (!items.length) select.append(new Option(empty, ""));
    select.value = added ? added.id : ids.includes(before) ? before : ids.at(-1) || "";
  }

  soundChosen() {
    const sound = this.state?.sounds.find((one) => one.id === element("sound").value);
    if ((sound?.seconds || 0) !== this.pad.duration) this.pad.setDuration(sound?.seconds || 0);
  }

  invite() {
    element("empty").classList.add("idle");
    element("empty-text").textContent = this.state.sounds.length
      ? "Choose an emotion and press “Make a take”." : "Drop a recording of speech here, or record your voice.";
  }

  async loadTakes() {
    for (const { id } of this.state.takes) {
      if (this.known.has(id)) continue;
      this.known.set(id, null);
      const take = await openTake(new Uint8Array(await (await ask(`takes/${id}`)).arrayBuffer()), id);
      this.known.set(id, take);
      this.app.add(take);
      if (!this.live?.running) this.app.show([take]);
    }
    for (const [id, take] of this.known) {
      if (!take || this.state.takes.some((one) => one.id === id)) continue;
      this.known.delete(id);
      this.app.remove(take);
    }
  }

  listJobs() {
    const own = this.state.jobs.filter((job) => job.client === CLIENT && (["waiting", "running"].includes(job.state) || (job.state === "failed" && !this.dismissed?.has(job.id))));
    element("jobs").replaceChildren(...own.map((job) => {
      const row = Object.assign(document.createElement("div"), { className: `job ${job.state}` });
      const text = job.state === "failed" ? `${job.title}: ${job.message}` : job.state === "waiting" ? `${job.title} waits` : job.title;
      const close = Object.assign(document.createElement("button"), { className: "icon", title: job.state === "failed" ? "Dismiss" : "Stop", innerHTML: '<svg><use href="#i-close"/></svg>' });
      close.setAttribute("aria-label", `${close.title}: ${job.title}`);
      close.addEventListener("click", () => this.attempt(() => this.stop(job)));
      row.append(Object.assign(document.createElement("span"), { textContent: text }), close);
      if (job.state !== "failed") {
        const bar = Object.assign(document.createElement("progress"), { max: 1, value: job.share });
        bar.setAttribute("aria-label", job.title);
        row.append(bar);
      }
      return row;
    }));
  }

  async stop(job) {
    (this.dismissed ||= new Set()).add(job.id);
    if (job.state !== "failed") await ask(`jobs/${job.id}`, "DELETE");
    this.wake();
  }

  listTakes() {
    const { takes, formats } = this.state, list = element("kept");
    element("kept-title").hidden = takes.length === 0;
    const key = takes.map(({ id }) => id).join();
    if (key === this.listed) return; // what a person has open stays open
    this.listed = key;
    list.replaceChildren(...takes.map(({ id, name }) => {
      const row = document.createElement("li");
      const choice = document.createElement("select");
      choice.setAttribute("aria-label", `Download ${name}`);
      choice.append(new Option("Download", ""), ...formats.map((format) => new Option(format.toUpperCase(), format)));
      choice.addEventListener("change", () => this.attempt(() => this.download(id, choice)));
      const remove = Object.assign(document.createElement("button"), { className: "icon", title: `Remove ${name}`, innerHTML: '<svg><use href="#i-close"/></svg>' });
      remove.setAttribute("aria-label", remove.title);
      remove.addEventListener("click", () => this.attempt(async () => { await ask(`takes/${id}`, "DELETE"); this.wake(); }));
      row.append(Object.assign(document.createElement("span"), { textContent: `${this.known.get(id)?.letter ?? ""}  ${name}`, title: name }), choice, remove);
      return row;
    }));
    const source = element("live-source"), before = source.value;
    source.replaceChildren(new Option("the microphone", "microphone"), ...takes.map(({ id, name }) => new Option(`the recording of ${name}`, id)));
    source.value = takes.some(({ id }) => id === before) ? before : "microphone";
  }

  // ---- what the person does ----

  async addFiles(files) {
    for (const file of files) {
      const isMesh = this.state.mesh_suffixes.some((suffix) => file.name.toLowerCase().endsWith(suffix));
      if (file.size > this.state.limits.upload_bytes) throw new Error(`“${file.name}” is too large: at most ${this.state.limits.upload_bytes >> 20} MB.`);
      this.app.say(`Reading ${file.name} …`, null, true);
      if (isMesh) await ask("meshes", "POST", file, { name: file.name });
      else await ask("sounds", "POST", await fileToWav(file), { name: file.name });
      this.app.say(isMesh ? `${file.name} is the face now.` : `${file.name} is ready.`);
    }
    for (const id of ["sound-file", "mesh-file"]) element(id).value = "";
    this.wake();
  }

  connectDrops() {
    const app = element("app");
    addEventListener("dragover", (event) => { event.preventDefault(); app.classList.add("dropping"); });
    addEventListener("dragleave", (event) => { if (!event.relatedTarget) app.classList.remove("dropping"); });
    addEventListener("drop", (event) => {
      event.preventDefault();
      app.classList.remove("dropping");
      this.attempt(() => this.addFiles(event.dataTransfer.files));
    });
  }

  async remove(kind) {
    await ask(`${kind === "mesh" ? "meshes" : "sounds"}/${element(kind).value}`, "DELETE");
    this.wake();
  }

  /** Shows the mesh at rest and asks where its eyes, nose, mouth and chin are. */
  async markFace() {
    if (this.marking) return this.marking.end(null);
    const { app } = this, id = element("mesh").value, before = app.shown;
    const take = await openTake(new Uint8Array(await (await ask(`meshes/${id}`)).arrayBuffer()), "still");
    const leave = () => {
      app.scene.pin([]);
      app.scene.surfaces.delete(take);
      app.show(before.filter((one) => app.takes.includes(one)));
      if (!app.shown.length) this.invite();
    };
    app.player.pause();
    take.letter = "";
    app.scene.camera.reset(0, 0);
    app.show([take]);
    this.marking = new FaceMarking(app, take, this.state.marks, async (marks) => {
      this.marking = null;
      await this.attempt(async () => {
        if (!marks) return;
        const { landmarks } = await (await ask(`meshes/${id}/marks`, "POST", { marks })).json();
        app.scene.pin(landmarks);
        app.refresh();
        app.say("The face is there: these points move it.");
        this.wake();
        await new Promise((done) => setTimeout(done, 3000));
      });
      leave();
    });
  }

  async record() {
    const button = element("record");
    if (this.recorder) {
      const { recorder } = this;
      this.recorder = null;
      clearInterval(this.clock);
      button.textContent = "Record";
      button.classList.remove("on");
      const seconds = recorder.seconds, wav = recorder.stop();
      if (seconds < 0.3) throw new Error("That was too short to be speech.");
      this.recordings = (this.recordings || 0) + 1;
      await ask("sounds", "POST", wav, { name: `voice ${this.recordings}` });
      this.wake();
      return;
    }
    const recorder = new VoiceRecorder();
    await recorder.start(this.state.limits.sound_s, () => this.recorder && this.attempt(() => this.record()));
    this.recorder = recorder;
    button.classList.add("on");
    this.clock = setInterval(() => (button.textContent = `Stop · ${clockText(recorder.seconds)}`), 100);
  }

  async generate() {
    const seed = Number(element("seed").value);
    if (!Number.isSafeInteger(seed) || seed < 0) throw new Error("The variation is a whole number from 0 on.");
    await ask("takes", "POST", {
      mesh: element("mesh").value, sound: element("sound").value, seed, mouth_temperature: Number(element("freedom").value),
      articulation: Number(element("articulation").value), ...this.pad.wish(),
    });
    this.wake();
  }

  async download(id, choice) {
    const format = choice.value;
    choice.value = "";
    if (!format) return;
    const job = await (await ask(`takes/${id}/exports`, "POST", { format })).json();
    this.saving.set(job.id, (made) => Object.assign(document.createElement("a"), { href: `${BASE}exports/${made.id}`, download: made.result }).click());
    this.wake();
  }

  /** A job of this page is done: a file that was asked for is fetched. */
  finish(job) {
    const action = this.saving.get(job.id);
    if (!action || ["waiting", "running"].includes(job.state)) return;
    this.saving.delete(job.id);
    if (job.state === "done") action(job);
  }

  // ---- live ----

  async toggleLive() {
    if (this.live) return this.endLive("");
    const button = element("live-start");
    button.disabled = true;
    element("live-state").textContent = "Making the face ready. A new face takes some seconds.";
    const address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${BASE}live?mesh=${element("mesh").value}`;
    const live = new LiveStream(this.app, address, { ended: (why) => this.endLive(why), numbers: (...all) => this.showNumbers(...all) });
    this.app.player.pause();
    try {
      const source = this.known.get(element("live-source").value) || null;
      await live.start(source, { ...this.pad.now(), seed: Number(element("seed").value) || 0 }, element("live-hear").checked);
    } catch (error) {
      live.stop();
      element("live-state").textContent = error.message;
      return;
    } finally {
      button.disabled = false;
    }
    this.live = live;
    this.before = this.app.shown;
    this.app.show([live.take]);
    element("app").classList.add("live");
    element("live-numbers").hidden = false;
    button.textContent = "Stop";
    element("live-state").textContent = "Listening.";
  }

  endLive(why) {
    this.live?.stop();
    const take = this.live?.take;
    this.live = null;
    element("app").classList.remove("live");
    element("live-start").textContent = "Start";
    element("live-state").textContent = why;
    element("live-level").style.width = 0;
    this.app.show((this.before || []).filter((one) => this.app.takes.includes(one)));
    if (take) this.app.scene.surfaces.delete(take);
    if (!this.app.shown.length) this.invite();
  }

  showNumbers(latencies, worst, level) {
    element("live-level").style.width = `${Math.min(100, 130 * level)}%`;
    if (!latencies.length) return;
    const mean = latencies.reduce((a, b) => a + b, 0) / latencies.length;
    element("live-latency").textContent = `${mean.toFixed(2)} s`;
    element("live-worst").textContent = `${worst.toFixed(2)} s`;
    element("live-rate").textContent = String(latencies.length);
  }
}

function main() {
  let app;
  try {
    app = new App(JSON.parse(element("settings").textContent), [["make", "Create"], ["live", "Live"]]);
  } catch (error) {
    element("empty").classList.add("failed");
    element("empty-text").textContent = error.message;
    return;
  }
  const studio = new StudioPage(app);
  window.freetalk = {
    status: () => ({
      ...app.status(), connected: studio.state !== null, live: studio.live?.running ?? false, worst: studio.live?.worst ?? 0,
      delay: studio.live?.delay ?? 0, received: studio.live?.latencies.length ?? 0,
    }),
  };
  studio.run();
}

main();
