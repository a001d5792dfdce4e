// What the service says in English, in the page's language: its template and values come beside it, as `wording`.
import { pointed, sentence } from "./dom.js";
import { LANGUAGE, english, gaps, has, t } from "./texts.js";

/** @typedef {{ template: string, values: Record<string, any>, form?: "capital" | "clause" }} Told */
/** @type {Record<string, string>} */
const WORDS = JSON.parse(document.getElementById("wording").textContent);
/** @type {Map<string, Told>} */
const told = new Map();
const FORMS = { capital: sentence, clause: (text) => text.split(";")[0].replace(/\.$/, "") };

// A reviver of JSON: every body is read through it, and what it says is known from then on.
export function learn(key, value) {
  if (key === "wording" && value) for (const [text, of] of Object.entries(value)) told.set(text, of);
  return value;
}
const isKnown = (v) => Boolean(v?.template) && (v.template in WORDS || Object.values(v.values).some(isKnown));
function word(v) {
  if (v.figure) return pointed(v.figure);
  if (!v.template) return v;
  const text = gaps(WORDS[v.template] ?? v.template, (name) => word(v.values[name] ?? ""));
  return FORMS[v.form]?.(text) ?? text;
}

// In the page's language, with the language that it is: where there are no words for it, as it came.
export function said(text) {
  const of = told.get(text);
  return english || !of || !isKnown(of) ? { text, lang: "en" } : { text: word(of), lang: LANGUAGE };
}
export const say = (text) => said(text ?? "").text;
// What a run does now, as the page has it: "identifying, A2 spring 1".
export function phase(text) {
  const { stage, where } = told.get(text)?.values ?? {};
  if (stage) return `${phase(stage)}, ${where}`;
  return has(`phase.${text}`) ? t(`phase.${text}`) : say(text);
}
