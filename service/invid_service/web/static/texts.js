// The page's words in the language that the service found in the request. They stand within the page.
const TEXTS = JSON.parse(document.getElementById("texts").textContent);
export const LANGUAGE = document.documentElement.lang;

export const has = (key) => key in TEXTS;
export function t(key, values = {}) {
  return (TEXTS[key] ?? key).replace(/\{(\w+)\}/g, (all, name) => values[name] ?? all);
}
// A name that has no text, of an effect that somebody added, say, is shown as it is.
export const named = (family, name) => (has(`${family}.${name}`) ? t(`${family}.${name}`) : String(name).replaceAll("_", " "));
// What the service says in English stays so, and says so to a reader of screens.
export const english = LANGUAGE === "en";

// The service's phases carry numbers and names: "experiment 2 of 6" is "phase.experiment {1} of {2}".
const PHASES = Object.keys(TEXTS).filter((k) => k.startsWith("phase.")).map((key) => {
  const pattern = key.slice(6).replace(/[.*+?^$()|[\]\\]/g, "\\$&").replace(/\{\d\}/g, "(.+)");
  return { key, pattern: new RegExp(`^${pattern}$`) };
});
export function phase(said) {
  for (const { key, pattern } of PHASES) {
    const found = pattern.exec(said);
    if (found) return t(key, Object.fromEntries(found.slice(1).map((v, i) => [i + 1, v])));
  }
  // A known stage with something after it, which stays as it is: "identifying, A2 spring 1".
  const at = said.lastIndexOf(", ");
  return at < 0 ? said : `${phase(said.slice(0, at))}${said.slice(at)}`;
}

export function choose(language) {
  const path = new URL("../", import.meta.url).pathname; // a reverse proxy may show the service under a path
  document.cookie = `invid-language=${language}; path=${path}; max-age=31536000; SameSite=Strict`;
  location.reload();
}

export function and(words) {
  return words.length < 2 ? words.join("") : `${words.slice(0, -1).join(", ")}${t("word.and")}${words.at(-1)}`;
}
