// A page with its takes inside.

async function main() {
  const settings = JSON.parse(element("settings").textContent);
  let app;
  try {
    app = new App(settings);
  } catch (error) {
    element("empty").classList.add("failed");
    element("empty-text").textContent = error.message;
    return;
  }
  window.freetalk = { status: () => app.status() };
  try {
    const blobs = [...document.querySelectorAll("script.take")];
    for (const [index, blob] of blobs.entries()) {
      app.add(await openTake(fromBase64(blob.textContent), `take-${index}`));
      blob.remove();
    }
    app.show(app.takes);
    if (app.takes.some((take) => take.picture)) app.setSurface("texture");
    if (settings.truth !== undefined) app.setTruth(app.takes[settings.truth]);
  } catch (error) {
    app.fail(`This page is damaged: ${error.message}`);
  }
}

main();
