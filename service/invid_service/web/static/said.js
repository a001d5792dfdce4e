// What the service says in English, in the page's language: whole sentences with gaps, whose values are said in turn.
import { LANGUAGE, english, has, t } from "./texts.js";

const escaped = (text) => text.replace(/[.*+?^$()|[\]\\]/g, "\\$&");
// The longer ones first: they say more of a sentence.
const SENTENCES = Object.entries(JSON.parse(document.getElementById("said").textContent)).sort(([a], [b]) => b.length - a.length).map(([pattern, words]) => {
  const met = new Set(), gap = (all, n) => { const back = met.has(n); met.add(n); return back ? `\\k<v${n}>` : `(?<v${n}>.*?)`; };
  return { words, pattern: new RegExp(`^${escaped(pattern).replace(/\{(\d+)\}/g, gap)}$`) };
});

function whole(text) {
  for (const { words, pattern } of SENTENCES) {
    const found = pattern.exec(text);
    if (found) return words.replace(/\{(\d+)\}/g, (all, n) => value(found.groups[`v${n}`]));
  }
  return null;
}
const parts = (text, between, join) => {
  const said = text.split(between).map(whole);
  return said.length > 1 && !said.includes(null) ? said.join(join) : null;
};
// "coulomb friction on A1", as warnings name what was found.
function cause(text) {
  const [, name, axes] = /^(.+) on (\S+)$/.exec(text) ?? [], key = `cause.${name?.replaceAll(" ", "_")}`;
  return has(key) ? t("progress.found_on", { cause: t(key), axes }) : null;
}
const value = (text) => whole(text) ?? parts(text, ", ", ", ") ?? parts(text, "; ", "; ") ?? cause(text) ?? text.replace(/(\d)\.(?=\d)/g, `$1${t("number.point")}`);

// In the page's language, with the language that it is: where there are no words for it, as it came.
export function said(text) {
  const words = english ? text : whole(text) ?? parts(text, "; ", "; ") ?? parts(text, /(?<=[.?]) /, " ");
  return words == null ? { text, lang: "en" } : { text: words, lang: LANGUAGE };
}
