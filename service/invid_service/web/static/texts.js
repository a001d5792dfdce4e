// The page's words in the language that the service found in the request. They stand within the page.
const TEXTS = JSON.parse(document.getElementById("texts").textContent);
export const LANGUAGE = document.documentElement.lang;

export const has = (key) => key in TEXTS;
export function t(key, values = {}) {
  return gaps(TEXTS[key] ?? key, (name, all) => values[name] ?? all);
}
export const gaps = (text, of) => text.replace(/\{\{|\}\}|\{(\w+)\}/g, (all, name) => (name ? of(name, all) : all[0]));
// A name that has no text, of an effect that somebody added, say, is shown as it is.
export const named = (family, name) => (has(`${family}.${name}`) ? t(`${family}.${name}`) : String(name).replaceAll("_", " "));
// What the service says in English stays so, and says so to a reader of screens.
export const english = LANGUAGE === "en";

export function choose(language) {
  const path = new URL("../", import.meta.url).pathname; // a reverse proxy may show the service under a path
  document.cookie = `invid-language=${language}; path=${path}; max-age=31536000; SameSite=Strict`;
  location.reload();
}

export function and(words) {
  return words.length < 2 ? words.join("") : `${words.slice(0, -1).join(", ")}${t("word.and")}${words.at(-1)}`;
}
