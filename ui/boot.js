// Loads the studio, and says on the skeleton why it did not start.
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
