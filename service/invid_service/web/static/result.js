// The result: grade and headline, where it is, the decision; what was found; the numbers unfold below.
import { call, get } from "./api.js";
import { verified } from "./verify.js";
import { saidBefore } from "./changed.js";
import { changeLines, gradeBadge, headline, parameterLabel, showFindings, sizesOf, place, why } from "./findings.js";
import { cloud, curves, redraw } from "./plots.js";
import { $, clear, el, estimate, fill, fmt, time, typical } from "./dom.js";
import { said, say } from "./said.js";
import { spoken } from "./spoken.js";
import { offerTuning } from "./tuning.js";
import { LANGUAGE, english, has, named, t } from "./texts.js";

// Not before what stands above a button has its place: one that moves under a finger is pressed by mistake.
let shown = null, settled = null, latest = null, diagnosed = null;
const PATIENCE_MS = 3000;
const FILES = { report: "report.html", model: "model.json", diagnosis: "diagnosis.json", recording: "recording.h5" };

/** @param {Run} run */
export function showDecision(run) {
  latest = run;
  $("decide").hidden = run.state !== "awaiting_accept";
  const d = run.decision;
  $("decision").textContent = d ? `${t(`result.${d.type}`, { by: d.by })}${d.override ? ` ${t("result.reason", { reason: d.override })}` : ""}` : "";
  // A result that is not to be trusted does not invite.
  $("untrusted").hidden = !run.untrusted;
  $("untrusted").textContent = run.untrusted ? `${t("untrusted.title")}: ${why(run)}` : "";
  $("accept").classList.toggle("primary", !run.untrusted);
  $("reject").classList.toggle("primary", Boolean(run.untrusted));
  separating(run, diagnosed);
  offerTuning(run);
  $("accept").textContent = run.untrusted ? t("result.accept_anyway") : t("result.accept");
  printHead(run);
}

/** @param {Run} run */
function printHead(run) {
  const d = run.decision, lines = [t("print.run", { id: run.id }), t("print.cell", { cell: run.cell ?? "–", robot: run.robot }),
    t("print.time", { started: time(run.started ?? run.created), ended: time(run.ended) || "–" }), t("print.by", { by: run.requested_by }),
    d && t("print.decided", { decision: $("decision").textContent, time: time(d.at) }), t("print.version", { version: document.body.dataset.version, time: time(Date.now()) })];
  fill($("print-head"), lines.filter(Boolean).map((line) => el("p", {}, line)));
}
window.addEventListener("beforeprint", () => { const last = $("print-head").lastElementChild; if (last) last.textContent = t("print.version", { version: document.body.dataset.version, time: time(Date.now()) }); });

/** @param {Run} run */
export async function showResult(run) {
  const card = $("result-card"), summary = run.summary;
  card.hidden = false;
  showDecision(run);
  if (shown === run.id) return;
  shown = run.id;
  $("run-facts").textContent = t("run.facts", { kind: named("mode", run.mode), time: time(run.started ?? run.created), by: run.requested_by }) + (run.simulated ? ` ${t("run.simulated")}` : "") + (run.changed ? `. ${saidBefore(run)}` : "");
  fill($("grade"), [gradeBadge(summary.grade ?? "none")]);
  $("sentence").textContent = headline(summary);
  $("sentence").lang = said(summary.headline ?? "").lang;
  $("sentence").focus({ preventScroll: true });
  window.scrollTo(0, 0);
  const lines = changeLines(summary.changes);
  $("changes").hidden = !lines.length;
  fill($("changes-lines"), lines.map((line) => el("li", {}, line)));
  warnings(summary);
  fill($("links"), Object.entries(FILES).map(([name, file]) => el("a", { href: run.links[name], "data-download": `${run.id}-${file}` }, t(`file.${name}`))));
  for (const id of ["axis-choice", "frf", "missing", "where", "numbers"]) $(id).hidden = true;
  $("numbers").open = $("notes").open = false;
  for (const id of ["causes", "parameters", "findings", "drawing"]) clear($(id));
  $("verified")?.remove();
  $("where").firstElementChild.textContent = run.mode === "verify" ? t("verified.title") : t("result.where");
  if (run.mode === "verify") { await showVerified(run); return; }
  let model, diagnosis, changes;
  try {
    const compared = summary.changes ? get(run.links.changes).catch(() => summary.changes) : null;
    [model, diagnosis, changes] = await Promise.all([get(run.links.model), get(run.links.diagnosis).catch(() => null), compared]);
  } finally { if (!model) { settled = run.id; showDecision(latest); } }
  if (shown !== run.id) return;
  showFindings(run, diagnosis, model);
  diagnosed = diagnosis;
  $("numbers").hidden = false;
  parameters(model, changes);
  const drawn = drawing(run);
  await Promise.race([drawn, new Promise((resolve) => setTimeout(resolve, PATIENCE_MS))]);
  settled = run.id;
  if (latest.id === run.id) showDecision(latest);
  await drawn;
  const plots = await get(run.links.plots).catch(() => null);
  if (plots && shown === run.id) pictures(plots, sizesOf(model));
}
$("numbers").addEventListener("toggle", redraw); // folded, a plot has no width

/** @param {Run} run */
async function showVerified(run) {
  fill($("links"), [["recording", "recording.h5"], ["verification", "verification.json"]].map(([name, file]) => el("a", { href: run.links[name], "data-download": `${run.id}-${file}` }, t(`file.${name}`))));
  const made = await verified(run);
  if (shown !== run.id) return;
  $("findings").before(made);
  settled = run.id;
  await drawing(run, run.links["verification-picture"]);
}

// The service draws; the same picture as in the report. As SVG within the page it takes the page's colours.
/** @param {Run} run */
async function drawing(run, address = `${run.links.self}/drawing?lang=${LANGUAGE}`) {
  /** @type {any} */
  let svg;
  try {
    const text = await (await call("GET", address)).text();
    svg = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
  } catch (error) {
    if (shown === run.id) { $("where").hidden = false; fill($("drawing"), [el("p", { class: "quiet" }, t("result.no_drawing", { why: error.message }))]); }
    return;
  }
  if (shown !== run.id || svg.nodeName !== "svg") return;
  svg.removeAttribute("style"); // white paper is for a file of its own
  const picture = document.importNode(svg, true), width = svg.viewBox.baseVal.width;
  // Never so small that its numbers cannot be read, nor larger than the text beside it.
  picture.style.minWidth = `${0.8 * width}px`;
  picture.style.maxWidth = `${1.35 * width}px`;
  fill($("drawing"), [picture]);
  $("where").hidden = false;
}

/** @param {Run} run */
function separating(run, diagnosis) {
  const s = run.separating, offered = s && settled === run.id && ["awaiting_accept", "succeeded"].includes(run.state);
  $("separate-card").hidden = !offered;
  if (!offered) return;
  const finding = diagnosis?.findings?.[s.finding], other = finding?.alternatives?.find((a) => a.cause !== finding.cause);
  const names = finding && other ? { first: `${finding.axis}: ${named("cause", finding.cause)}`, other: named("cause", other.cause) } : null;
  fill($("separate-note"), [names ? t("separate.note", names) : t("separate.plain"), s.text ? spoken("small", s.text) : null].filter(Boolean));
}

function warnings(summary) {
  const all = [...new Set([...(summary.warnings ?? []), ...(summary.changes?.warnings ?? [])].filter(Boolean))];
  $("notes").hidden = !all.length;
  $("notes-title").textContent = t("result.warnings", { n: all.length });
  const lines = all.map((w) => spoken("li", w));
  fill($("warnings"), [...(english || lines.every((l) => l.lang !== "en") ? [] : [el("li", { class: "quiet" }, t("page.untranslated"))]), ...lines]);
}

// Every number of a model: label, name in series and changes, estimate, unit.
export function numbersOf(model) {
  const u = model.units ?? {}, sizes = sizesOf(model), lines = [];
  const add = (name, e, unit, group) => lines.push({ label: parameterLabel(name, sizes), name, e, unit, group });
  for (const b of model.branches) {
    b.masses.forEach((e, i) => add(`${b.axis}.mass.${i + 1}`, e, u.mass, b.axis));
    b.springs.forEach((e, i) => add(`${b.axis}.spring.${i + 1}`, e, u.stiffness, b.axis));
    b.dampers.forEach((e, i) => add(`${b.axis}.damper.${i + 1}`, e, u.damping, b.axis));
    if (b.ground_spring) add(`${b.axis}.ground_spring`, b.ground_spring, u.stiffness, b.axis);
  }
  for (const c of model.couplings ?? []) add(`${c.between.join("-")}.coupling`, c, u.mass, t("history.couplings"));
  return lines;
}

function parameters(model, changes) {
  const known = new Map([...(changes?.parameters ?? []), ...(changes?.effects ?? [])].map((p) => [p.parameter, p]));
  const lines = numbersOf(model), sizes = sizesOf(model);
  for (const x of model.effects ?? []) {
    for (const [n, e] of Object.entries(x.parameters)) {
      if (typeof e.value !== "number") continue; // the table of a law without a name is in its picture
      const where = place(x, sizes);
      lines.push({ label: t("param.effect", { axis: x.axis, cause: named("cause", x.cause), place: where ? ` (${where})` : "", name: named("effect", n) }), name: [x.axis, x.cause, x.element, x.other_axis, n].filter(Boolean).join("."), e, unit: e.unit });
    }
  }
  const change = (name) => {
    const p = known.get(name);
    if (!p) return "";
    if (p.status === "changed") return t("status.changed", { by: `${p.difference > 0 ? "+" : "−"}${estimate(Math.abs(p.difference), p.difference_std)}` });
    const seen = p.detectable_percent > 0 ? t("status.seen", { n: fmt(p.detectable_percent, 2) }) : "";
    if (p.status === "unchanged") return t("status.unchanged", { n: fmt(p.within_percent, 2) }) + seen;
    return `${t("status.cannot_tell")}${p.reason ? `: ${say(p.reason)}` : ""}`;
  };
  const head = [t("param.name"), t("param.value"), t("param.unit"), ...(known.size ? [t("param.change")] : [])];
  table(head, lines, known, change);
}
function table(head, lines, known, change) {
  const body = lines.map((l) => {
    const value = estimate(l.e.value, l.e.std) + (l.e.std == null ? ` ${t("param.unknown_std")}` : "");
    const cells = [el("b", {}, l.label), value, l.unit ?? "", ...(known.size ? [change(l.name)] : [])];
    return el("tr", { class: known.get(l.name)?.status === "changed" ? "changed" : null }, cells.map((c, i) => el("td", { "data-label": head[i] }, [c])));
  });
  fill($("parameters"), [el("thead", {}, [el("tr", {}, head.map((h) => el("th", { scope: "col" }, h)))]), el("tbody", {}, body)]);
}

// A row of buttons of which one is chosen; `draw` gets the entry.
function chooser(target, entries, label, draw) {
  const buttons = entries.map((entry) => {
    const b = el("button", { type: "button" }, label(entry));
    b.addEventListener("click", () => choose(entry, b));
    return b;
  });
  const choose = (entry, button) => {
    for (const b of buttons) b.setAttribute("aria-pressed", String(b === button));
    draw(entry);
  };
  fill(target, buttons);
  choose(entries[0], buttons[0]);
}

function pictures(plots, sizes) {
  const missing = new Map((plots.missing_torque ?? []).map((m) => [m.axis, m]));
  if (plots.frf?.length) {
    $("axis-choice").hidden = false;
    $("frf").hidden = false;
    chooser($("frf-axis"), plots.frf, (entry) => entry.axis, (entry) => { response(entry); frequency(missing.get(entry.axis)); });
  }
  for (const view of plots.views ?? []) $("causes").append(cause(view, sizes));
}

// Median distance of the measured points from a curve, in per cent.
function off(entry, curve) {
  if (!entry.measured?.frequency_hz.length || !curve) return null;
  const found = entry.measured.frequency_hz.map((f, i) => {
    let k = entry.frequency_hz.findIndex((g) => g >= f);
    k = k < 0 ? entry.frequency_hz.length - 1 : k;
    return Math.abs(entry.measured.magnitude[i] - curve.magnitude[k]) / curve.magnitude[k];
  });
  return 100 * typical(found);
}

function response(entry) {
  const { before, after } = entry.simulated, series = [];
  // The wide line lies under the narrow one: where both agree, both are seen.
  if (before) series.push({ label: t("chart.before"), x: entry.frequency_hz, y: before.magnitude, colour: "--before", dash: 0, width: 7 });
  if (after) series.push({ label: t("chart.after"), x: entry.frequency_hz, y: after.magnitude, colour: "--after", dash: 0, width: 2.5 });
  if (entry.measured) series.push({ label: t("chart.measured"), x: entry.measured.frequency_hz, y: entry.measured.magnitude, colour: "--measured", points: true });
  const peaks = entry.peaks_hz.map((p) => fmt(p, 3)).join(", ") || "–", gap = off(entry, before);
  const alt = gap == null ? t("chart.response.alone", { axis: entry.axis, peaks })
    : t("chart.response.alt", { axis: entry.axis, peaks, before: fmt(gap, 2), after: fmt(off(entry, after ?? before), 2) });
  curves($("frf-plot"), { x: t("chart.frequency"), y: t("chart.response.y", { unit: entry.unit }), series, peaks: entry.peaks_hz, alt });
}

function frequency(m) {
  const there = Boolean(m?.excited?.frequency_hz?.length);
  $("missing").hidden = !there;
  if (!there) return;
  const series = [{ label: t("chart.missing.shaken"), x: m.excited.frequency_hz, y: m.excited.before, colour: "--before", dash: 0 }];
  if (m.silent?.frequency_hz?.length) series.push({ label: t("chart.missing.between"), x: m.silent.frequency_hz, y: m.silent.before, colour: "--third", dash: 1, width: 1.5 });
  series.push({ label: t("chart.noise"), x: m.frequency_hz, y: m.noise_floor, colour: "--quiet", dash: 2 });
  const most = Math.max(...m.excited.before), at = m.excited.frequency_hz[m.excited.before.indexOf(most)];
  const near = m.frequency_hz.reduce((best, f, i) => (Math.abs(f - at) < Math.abs(m.frequency_hz[best] - at) ? i : best), 0);
  const alt = t("chart.missing.alt", { axis: m.axis, at: fmt(at, 3), most: fmt(most, 2), unit: m.unit, floor: fmt(m.noise_floor[near], 2) });
  curves($("missing-plot"), { x: t("chart.frequency"), y: t("chart.missing.y", { unit: m.unit }), series, alt });
}

const UNIT = /\[(.*)\]$/;
function cloudAlt(side, unit, xLabel) {
  let text = t("chart.cloud.alt", { n: side.x.length, x: xLabel, low: fmt(Math.min(...side.y), 2), high: fmt(Math.max(...side.y), 2), unit });
  if (side.fit?.y.length === side.y.length) {
    const power = (values) => { const mean = values.reduce((a, b) => a + b, 0) / values.length; return values.reduce((a, b) => a + (b - mean) ** 2, 0); };
    const share = 1 - power(side.y.map((v, i) => v - side.fit.y[i])) / (power(side.y) || 1);
    text += ` ${t("chart.cloud.fit", { n: fmt(100 * Math.max(share, 0), 2) })}`;
  }
  return text;
}

// One cause: its torque over what it depends on, then over the rest, then over frequency.
function cause(view, sizes) {
  const target = el("div", { class: "plot" }), buttons = el("div", { class: "choices", role: "group", "aria-label": t("chart.cause.over") });
  const where = view.cause ? place(view, sizes) : "", unit = UNIT.exec(view.y_label)?.[1] ?? "", yLabel = t("chart.cause.y", { unit });
  const fitted = view.sides.some((s) => s.fit), note = view.note && english ? ` (${view.note})` : "";
  const entries = [...view.sides, ...(view.spectrum?.frequency_hz?.length ? [{ what: "frequency" }] : [])];
  const draw = (side) => {
    if (side.what !== "frequency") {
      const xLabel = has(`over.${side.what}`) ? `${t(`over.${side.what}`)} [${UNIT.exec(side.x_label)?.[1] ?? ""}]` : side.x_label;
      cloud(target, { x: side.x, y: side.y, fit: side.fit, law: side.law, xLabel, yLabel, alt: cloudAlt(side, unit, xLabel) });
      return;
    }
    const s = view.spectrum, series = [{ label: t("chart.lost"), x: s.frequency_hz, y: s.missing, colour: "--measured", dash: 0 }];
    if (s.left) series.push({ label: t("chart.left"), x: s.frequency_hz, y: s.left, colour: "--before", dash: 1 });
    series.push({ label: t("chart.noise"), x: s.frequency_hz, y: s.noise_floor, colour: "--quiet", dash: 2 });
    const alt = t("chart.spectrum.alt", { before: fmt(typical(s.missing), 2), after: fmt(typical(s.left ?? s.missing), 2), unit });
    curves(target, { x: t("chart.frequency"), y: yLabel, series, alt });
  };
  const caption = t("chart.cause", { axis: view.axis, cause: view.cause ? named("cause", view.cause) : t("chart.cause.none"), place: where ? ` ${where}` : "", note }) + (fitted ? ` ${t("chart.cause.fit")}` : "") + (fitted && view.band_hz ? ` ${t("chart.cause.band", { low: fmt(view.band_hz[0], 2), high: fmt(view.band_hz[1], 2) })}` : "");
  const figure = el("figure", {}, [el("figcaption", {}, caption), buttons, target]);
  // Drawn when it has a width, which it has only on the page.
  queueMicrotask(() => chooser(buttons, entries, (e) => t("chart.over", { what: named("over", e.what) }), draw));
  return figure;
}

