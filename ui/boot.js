// Loads the studio, and says on the skeleton why it did not start.
// F1 opens the studio's help, not the browser's.
addEventListener("keydown", (event) => {
  if (event.key === "F1") event.preventDefault();
});
try {
  const { default: init } = await import("/{{script}}");
  await init({ module_or_path: "/{{wasm}}" });
} catch (error) {
  document.getElementById("skeleton-text").textContent =
    `The studio could not start: ${error}. It needs a browser with WebGL 2 and WebAssembly.`;
}
