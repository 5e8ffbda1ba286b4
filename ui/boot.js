// Loads the studio, and says on the skeleton why it did not start.
try {
  const { default: init } = await import("/{{script}}");
  await init({ module_or_path: "/{{wasm}}" });
} catch (error) {
  document.getElementById("skeleton-text").textContent =
    `The studio could not start: ${error}. It needs a browser with WebGL 2 and WebAssembly.`;
}
