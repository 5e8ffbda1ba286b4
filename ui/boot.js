// Loads the studio, and says on the skeleton why it did not start.

/** A page that loses its graphics sooner than this would lose them again. */
const RELOADED_AFTER_MS = 10_000;

// After a driver was started again or a computer slept, WebGL paints nothing more until it is set up anew. The address has all that
// is looked at, and control over a hand ends as when the page is closed.
document.getElementById("palpate").addEventListener("webglcontextlost", () => {
  if (performance.now() > RELOADED_AFTER_MS) return location.reload();
  const lost = Object.assign(document.createElement("p"), { id: "lost", role: "alert" });
  lost.textContent = "The browser's graphics stopped working. Reload the page; where that does not help, start the browser again.";
  document.body.append(lost);
});
// F1 opens the studio's help, not the browser's.
addEventListener("keydown", (event) => {
  if (event.key === "F1") event.preventDefault();
});
try {
  // egui's shader can filter textures in a slow way, for pictures that must be alike on all machines, and can dither.
  // The page asks for neither, but a processor that stands in for a graphics card works out both for every pixel.
  // Without them a frame takes half the time.
  const { shaderSource } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.shaderSource = function (shader, source) {
    const lean = source.replace(/\b\w+\.(predictable_texture_filtering|dithering)\b/g, "0u");
    shaderSource.call(this, shader, lean);
  };
  const { default: init } = await import("/{{script}}");
  await init({ module_or_path: "/{{wasm}}" });
} catch (error) {
  document.getElementById("skeleton-text").textContent =
    `The studio could not start: ${error}. It needs a browser with WebGL 2 and WebAssembly.`;
}
