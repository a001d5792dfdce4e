// What the service says with a code: in the page's language where the catalogue has it, else as it is, in English.
import { Problem } from "./api.js";
import { el, sentence, when } from "./dom.js";
import { said } from "./said.js";
import { and, english, has, t } from "./texts.js";

const ours = (key) => !english && has(key);
const detail = (text) => spoken("small", text);

// A sentence of the service as an element, in the page's language where there are words for it.
export function spoken(kind, text) {
  const words = said(text);
  return el(kind, { lang: words.lang }, sentence(words.text));
}

// A reason why a cell cannot start, or a note beside it, with its way out.
/** @param {Api["Reason"] | Api["Note"]} r */
export function reasonItem(r, key = `reason.${r.code}`) {
  const values = r.values?.text ? { ...r.values, text: said(r.values.text).text } : r.values;
  const known = ours(key), [text, fix] = known ? [t(key, values), t(`${key}.fix`, values)] : [sentence(r.text), r.fix];
  return el("li", { lang: known ? null : "en" }, [el("b", {}, text), t("ready.todo", { fix })]);
}

// A request that was refused, or one that got no answer, in a word.
const keyOf = (problem) => `problem.${(problem.document.type ?? "").split(":").at(-1)}`;
export function whyNot(error) {
  if (!(error instanceof Problem)) return t("page.silent");
  return has(keyOf(error)) ? t(keyOf(error)) : error.message;
}
/** @param {Problem} problem */
export function refused(problem) {
  const key = keyOf(problem);
  if (!ours(key)) return [problem.message];
  const reasons = (problem.document.reasons ?? []).filter((r) => ours(`reason.${r.code}`));
  if (reasons.length) return [`${t(key)}: ${reasons.map((r) => `${t(`reason.${r.code}`, r.values)} ${t("ready.todo", { fix: t(`reason.${r.code}.fix`, r.values) })}`).join(" ")}`];
  if (problem.document.state) return [`${t(key)} (${t(`phase.${problem.document.state}`)}).`];
  return [`${t(key)}.`, detail(problem.message)];
}

// Why a run ended early. What the service itself knows is a code with values. A stopped one has its one action beside it;
// two that differ are none.
/** @param {Run} run */
export function ended(run) {
  const stop = run.stopped, { code, text, fix, values, axes, known } = run.error, reason = stop?.reason ?? text;
  const key = stop?.code ? `halt.${stop.code}` : `error.${code}`;
  if (values && !stop?.code) {
    const what = t(key, values.state ? { ...values, state: t(`phase.${values.state}`) } : values), do_ = t(`${axes ? "error.unseen" : key}.fix`);
    const seen = (axes ?? []).map((a) => (a.state ? t("error.axis_seen", { ...a, time: when(a.at * 1000) }) : t("error.axis_unseen", a)));
    return [`${[what, axes ? t("error.unseen") : ""].join(" ").trim()} ${t("ready.todo", { fix: do_ })}`, ...[...seen, ...(known ?? [])].map(detail)];
  }
  if (!ours(key)) return [`${sentence(said(reason).text)}.${stop ? "" : ` ${t("ready.todo", { fix })}`}`];
  return [stop ? t(key) : `${t(key)} ${t("ready.todo", { fix: t(`${key}.fix`) })}`, ...rest(reason, t(key).replace(/\.$/, ""))];
}

// The service's own words, without those at their beginning that the page says already.
function rest(reason, known) {
  const { text, lang } = said(reason), whole = sentence(text);
  const left = whole.startsWith(known) ? whole.slice(known.length).replace(/^[;.] */, "") : whole;
  return left ? [el("small", { lang }, sentence(left))] : [];
}

// Before arming: loads that must not be able to fall far.
export function supporting(support) {
  return support ? t("plan.support", { axes: and(support.axes) }) : "";
}
