// Sentences of the service as parts of the page; where one has no words in its language, what kind it is, and it itself.
import { Problem } from "./api.js";
import { el, sentence, when } from "./dom.js";
import { said, say } from "./said.js";
import { LANGUAGE, and, t } from "./texts.js";

const detail = (text) => spoken("small", text);
const closed = (text) => sentence(/[.?!]$/.test(text) ? text : `${text}.`);
const todo = (fix) => t("ready.todo", { fix: say(fix) });

export function spoken(kind, text) {
  const words = said(text);
  return el(kind, { lang: words.lang }, sentence(words.text));
}

// A reason why a cell cannot start, or a note beside it, with its way out.
/** @param {Api["Reason"] | Api["Note"]} r */
export const reasonItem = (r) => el("li", { lang: said(r.text).lang }, [el("b", {}, sentence(say(r.text))), todo(r.fix)]);

// A request that was refused, or one that got no answer, in a word.
export const whyNot = (error) => (error instanceof Problem ? say(error.document.title ?? error.message) : t("page.silent"));
/** @param {Problem} problem */
export function refused({ document, message }) {
  if (said(message).lang === LANGUAGE || !document.title) return [say(message)];
  return [closed(say(document.title)), detail(message)];
}

// Why a run ended early; a stopped one has its one action beside it.
/** @param {Run} run */
export function ended(run) {
  const { stopped, error: { text, what, fix, axes, known } } = run, kind = stopped?.what || what;
  const why = axes ? what : stopped?.reason ?? text, beside = stopped && !axes ? "" : ` ${todo(fix)}`;
  const seen = (axes ?? []).map((a) => (a.state ? t("axis.seen", { ...a, time: when(a.at * 1000) }) : t("axis.unseen", a)));
  if (said(why).lang === LANGUAGE || !kind) return [`${closed(say(why))}${beside}`, ...[...seen, ...(axes ? known ?? [] : [])].map(detail)];
  return [`${closed(say(kind))}${beside}`, detail(why)];
}

// Before arming: loads that must not be able to fall far.
export function supporting(support) {
  return support ? t("plan.support", { axes: and(support.axes) }) : "";
}
