// Marking a face on a mesh, point by point.

const STILL = 4; // pixels that a pointer may move and still has clicked

class FaceMarking {
  /** Asks for these places of a take that is shown alone; `done` is given what was marked, or null where it was given up. */
  constructor(app, take, names, done) {
    this.app = app;
    this.take = take;
    this.names = names;
    this.done = done;
    this.marks = [];
    this.gone = new AbortController();
    const view = element("view"), { signal } = this.gone;
    view.addEventListener("pointerdown", (event) => (this.began = [event.clientX, event.clientY]), { signal });
    view.addEventListener("pointerup", (event) => this.clicked(event), { signal });
    document.addEventListener("keydown", (event) => this.key(event), { signal, capture: true });
    view.classList.add("marking");
    this.ask();
  }

  ask() {
    const { app, marks, names } = this;
    app.scene.pin(marks.flat());
    app.refresh();
    if (marks.length === names.length) return this.end(marks);
    app.say(`Click ${names[marks.length]} (${marks.length + 1} of ${names.length}).`, { text: marks.length ? "Back" : "Cancel", action: () => this.back() });
  }

  clicked({ button, clientX, clientY }) {
    if (button || !this.began || Math.hypot(clientX - this.began[0], clientY - this.began[1]) > STILL) return;
    const box = element("view").getBoundingClientRect();
    const across = (2 * (clientX - box.left)) / box.width - 1, upward = 1 - (2 * (clientY - box.top)) / box.height;
    const { eye, along } = this.app.scene.camera.ray(this.take.header.framing, box.width / box.height, across, upward);
    const mark = this.take.hit(eye, along);
    if (!mark) return;
    this.marks.push(mark);
    this.ask();
  }

  key(event) {
    if (!["Escape", "Backspace"].includes(event.key)) return;
    event.preventDefault();
    if (event.key === "Escape") this.end(null);
    else this.back();
  }

  back() {
    if (!this.marks.length) return this.end(null);
    this.marks.pop();
    this.ask();
  }

  end(marks) {
    this.gone.abort();
    element("view").classList.remove("marking");
    element("notice").hidden = true;
    this.done(marks);
  }
}
