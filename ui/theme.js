// The theme of the last visit, before anything is painted: index.html waits for this file.
try {
  const theme = localStorage.getItem("palpate-theme");
  if (theme === "dark" || theme === "light") document.documentElement.style.colorScheme = theme;
} catch {
  // A browser that keeps nothing.
}
