// What was found, in words of the page's language: headline, what changed, groups by grade.
import { $, el, fill, sentence } from "./dom.js";
import { say } from "./said.js";
import { spoken } from "./spoken.js";
import { named, t } from "./texts.js";

const GRADES = ["act", "watch", "as_expected", "none"];
const SHAPES = { act: "▲", watch: "◆", as_expected: "●", none: "■" };
const gradeOf = (finding) => finding.consequence?.grade ?? "none";

export function gradeBadge(grade) {
  const known = GRADES.includes(grade) ? grade : "none";
  return el("span", { class: `grade ${known}` }, `${SHAPES[known]} ${t(`grade.${known}`)}`);
}

// Masses an axis: "mass 3" of three is the load.
export const sizesOf = (model) => new Map((model?.branches ?? []).map((b) => [b.axis, b.masses.length]));
export function place(finding, sizes) {
  if (finding.other_axis) return t("place.between", { one: finding.axis, other: finding.other_axis });
  const [kind, n] = (finding.element ?? "").split(" ");
  if (kind === "spring") return t("place.spring", { n });
  if (kind !== "mass") return "";
  if (n === "1") return t("place.motor");
  return String(sizes.get(finding.axis)) === n ? t("place.load") : t("place.mass", { n });
}


export const headline = (summary) => say(summary.headline);

// Why a result is not to be trusted: its weightiest reason.
/** @param {Run} run */
export const why = (run) => (run.untrusted ? `${sentence(say(run.untrusted))}.` : "");

// What changed against another model, in full.
export const changeLines = (changes) => (changes?.sentences ?? []).map(say);

// "A1.spring.2" as a person says it.
export function parameterLabel(name, sizes) {
  const [, axis, kind, n] = /^(.*)\.(mass|spring|damper)\.(\d+)$/.exec(name) ?? [];
  if (kind === "mass") return t(sizes.get(axis) === Number(n) && n !== "1" ? "param.final" : "param.mass", { axis, n });
  if (kind === "spring") return t("param.spring", { axis, n });
  if (kind === "damper") return t("param.damper", { axis, n });
  if (name.endsWith(".ground_spring")) return t("param.ground", { axis: name.slice(0, -14) });
  if (name.endsWith(".coupling")) return t("param.coupling", { pair: name.slice(0, -9).replace("-", "–") });
  return name.replaceAll("_", " ");
}

/** @param {Run} run
 * @param {Model | null} model */
export function showFindings(run, diagnosis, model) {
  const findings = run.summary.findings ?? [], full = diagnosis?.findings ?? [];
  const sizes = sizesOf(model), groups = [], size = (f) => say(f.consequence?.text);
  findings.forEach((f, i) => { f.number = i + 1; });
  for (const grade of GRADES) {
    const list = findings.filter((f) => gradeOf(f) === grade);
    if (!list.length) continue;
    groups.push(el("h3", {}, [gradeBadge(grade), ` ${t(`grade.${grade}.todo`)}`]), el("ul", { class: "findings" }, list.map((f) => {
      const others = [...new Set((full[f.number - 1]?.alternatives ?? []).map((a) => named("cause", a.cause)))].filter((a) => a !== named("cause", f.cause));
      return el("li", {}, [el("span", { class: `number ${grade}` }, String(f.number)), el("span", {}, [
        el("b", {}, `${f.axis}: ${named("cause", f.cause)}`), place(f, sizes) ? ` ${place(f, sizes)}` : "", size(f) ? `, ${size(f)}` : "",
        others.length ? el("small", {}, t("finding.or", { cause: others.join(t("word.or")) })) : null])]);
    })));
  }
  const lost = diagnosis?.unexplained;
  if (lost) groups.push(el("h3", {}, [gradeBadge("none"), ` ${t("finding.no_name", { axis: lost.axis })}`]), spoken("p", lost.sentence));
  const sentences = run.summary.sentences ?? [];
  if (sentences.length) {
    groups.push(el("details", { id: "sentences-box" }, [el("summary", {}, t("result.details")),
      el("ul", { id: "sentences", class: "reasons" }, [...sentences.map((s) => spoken("li", s)),
        ...[...new Set(findings.map((f) => f.consequence?.source).filter((s) => s && s !== "config"))].map((source) => el("li", { class: "quiet" }, t("finding.source", { source: say(source) })))])]));
  }
  fill($("findings"), groups.length ? [el("h3", { class: "over" }, t("result.findings")), ...groups] : []);
}
