// What was found, in words of the page's language: headline, what changed, groups by grade.
import { $, el, estimate, fill, fmt, sentence } from "./dom.js";
import { said } from "./said.js";
import { spoken } from "./spoken.js";
import { LANGUAGE, english, has, named, t } from "./texts.js";

const SURE = 0.9; // confidence from which a cause is named without reserve
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

// "0.2 % of rated torque" of what the service measured; its own words where one of them has none here.
export function size(finding, linear) {
  const c = finding.consequence, measures = Object.entries(c?.measures ?? {});
  if (!c || english || !measures.length || !measures.every(([name]) => has(`measure.${name}`))) return c?.text ?? "";
  return measures.map(([name, v]) => t(`measure.${name}`, {
    percent: `${fmt(100 * v, 2)} %`, signed: `${v > 0 ? "+" : "−"}${fmt(Math.abs(100 * v), 2)} %`,
    angle: linear ? `${fmt(1e3 * v, 2)} mm` : `${fmt(1e3 * v, 2)} mrad`, ms: `${fmt(1e3 * v, 2)} ms`,
  })).join(", ");
}
export const linearOf = (model) => model?.units?.mass === "kg";

// Sentences are the service's, in the page's language; of a run of an earlier release, in English.
export const headline = (summary) => summary.headlines?.[LANGUAGE] ?? summary.headline ?? "";
export const spokenHeadline = (summary) => (summary.headlines?.[LANGUAGE] ? null : "en");

// Why a result is not to be trusted: its weightiest reason.
/** @param {Run} run */
export function why(run) {
  const said = run.untrusted && (run.summary?.doubts?.[0]?.texts[LANGUAGE] ?? run.untrusted);
  return said ? `${sentence(said)}.` : "";
}

// What changed against another model, in full.
export const changeLines = (changes) => (changes ? changes.lines?.[LANGUAGE] ?? changes.sentences ?? [] : []);

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

// A finding in full, from its numbers; in English, and where the numbers are gone, as the service put it.
function told(text, findings, full, sizes, linear) {
  const n = english ? -1 : findings.findIndex((f) => f.sentence === text), f = full[n];
  if (!f) return spoken("li", text);
  const numbers = Object.entries(f.parameters).filter(([, e]) => typeof e.value === "number").map(([name, e]) => `${named("effect", name)} ${estimate(e.value, e.std)}${e.unit && e.unit !== "1" ? ` ${e.unit}` : ""}`);
  const others = [...new Set((f.alternatives ?? []).map((a) => named("cause", a.cause)))].filter((a) => a !== named("cause", f.cause));
  const doubtful = others.length || f.confidence < SURE, experiment = f.separating_experiment && (f.separating_experiment.kind === "constant_velocity" ? "speeds" : "amplitudes");
  const parts = [
    t("finding.full", { axis: f.axis, cause: named("cause", f.cause), place: place(f, sizes) && ` ${place(f, sizes)}`, numbers: numbers.join(", "), share: fmt(100 * f.gain.fraction, 2), confidence: fmt(f.confidence, 3) }),
    others.length && `${sentence(t("finding.or", { cause: others.join(t("word.or")) }))}.`,
    size(f, linear) && `${sentence(size(f, linear))}: ${t(`grade.${gradeOf(f)}`)}.`,
    doubtful ? experiment && `${t("finding.sure", { experiment: t(`experiment.${experiment}`) })}.` : gradeOf(f) !== "as_expected" && has(`check.${f.cause}`) && t(`check.${f.cause}`)];
  return el("li", {}, parts.filter(Boolean).join(" "));
}

/** @param {Run} run
 * @param {Model | null} model */
export function showFindings(run, diagnosis, model) {
  const findings = run.summary.findings ?? [], full = diagnosis?.findings ?? [];
  const sizes = sizesOf(model), linear = linearOf(model), groups = [];
  findings.forEach((f, i) => { f.number = i + 1; });
  for (const grade of GRADES) {
    const list = findings.filter((f) => gradeOf(f) === grade);
    if (!list.length) continue;
    groups.push(el("h3", {}, [gradeBadge(grade), ` ${t(`grade.${grade}.todo`)}`]), el("ul", { class: "findings" }, list.map((f) => {
      const others = [...new Set((full[f.number - 1]?.alternatives ?? []).map((a) => named("cause", a.cause)))].filter((a) => a !== named("cause", f.cause));
      return el("li", {}, [el("span", { class: `number ${grade}` }, String(f.number)), el("span", {}, [
        el("b", {}, `${f.axis}: ${named("cause", f.cause)}`), place(f, sizes) ? ` ${place(f, sizes)}` : "", size(f, linear) ? `, ${size(f, linear)}` : "",
        others.length ? el("small", {}, t("finding.or", { cause: others.join(t("word.or")) })) : null])]);
    })));
  }
  const lost = diagnosis?.unexplained;
  if (lost) groups.push(el("h3", {}, [gradeBadge("none"), ` ${t("finding.no_name", { axis: lost.axis })}`]), spoken("p", lost.sentence));
  const against = diagnosis?.against;
  if (against) {
    groups.push(el("h3", {}, t("result.against")), el("ul", { id: "against", class: "reasons" }, against.sentences.map((line) => spoken("li", line))));
    if (against.corrected) groups.push(el("p", { class: "links" }, [el("a", { id: "corrected", href: run.links.corrected, "data-download": `${run.id}-${against.corrected}` }, t("file.corrected"))]));
  }
  const sentences = run.summary.sentences ?? [];
  if (sentences.length) {
    groups.push(el("details", { id: "sentences-box" }, [el("summary", {}, t("result.details")),
      el("ul", { id: "sentences", class: "reasons" }, [...sentences.map((s) => told(s, findings, full, sizes, linear)),
        ...[...new Set(findings.map((f) => f.consequence?.source).filter((s) => s && s !== "config"))].map((source) => el("li", { class: "quiet" }, t("finding.source", { source: said(source).text })))])]));
  }
  fill($("findings"), groups.length ? [el("h3", { class: "over" }, t("result.findings")), ...groups] : []);
}
