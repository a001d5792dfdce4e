// The result: the sentence first, the pictures under it, the numbers under those.
import { get } from "./api.js";
import { cloud, curves } from "./plots.js";
import { el, estimate, fill, fmt, table } from "./dom.js";

const $ = (id) => document.getElementById(id);
const VERDICTS = {
  consistent: "The model agrees with the robot: nothing beyond noise.",
  explained: "The simulation lacked something, and the cause is found.",
  partly_explained: "Part of what the simulation lacks is found, something is left.",
  unexplained: "The simulation lacks something that no known cause explains.",
};
let shown = null;

function headline(summary) {
  const fraction = summary.explained_fraction, said = VERDICTS[summary.verdict] ?? summary.verdict;
  // "Something is left" and "100 %" in one breath would be a riddle.
  if (summary.verdict === "partly_explained" && fraction > 0.99) return "Nearly all of what the simulation lacks is found, a small rest is left.";
  return fraction > 0 && /explained$/.test(summary.verdict) && summary.verdict !== "unexplained"
    ? `${said} The causes below make up ${fmt(100 * Math.min(fraction, 1), 2)} % of it.` : said;
}

export async function showResult(run, cell) {
  const card = $("result-card"), summary = run.summary;
  card.hidden = false;
  $("decide").hidden = run.state !== "awaiting_accept";
  $("decision").textContent = run.decision ? `Model ${run.decision.type} by ${run.decision.by}.` : "";
  if (shown === run.id) return;
  shown = run.id;
  const sentences = summary.sentences ?? [], several = sentences.length > 1;
  // One finding is the headline itself; several are summed up there and listed under it.
  $("sentence").textContent = (several ? null : sentences[0]) ?? headline(summary);
  $("sentence").focus({ preventScroll: true });
  card.scrollIntoView({ block: "start" });
  $("changes-sentence").textContent = summary.changes ? `Compared with the model in force: ${summary.changes.sentence}` : "";
  $("todo").hidden = !several;
  fill($("sentences"), several ? sentences.map((s) => el("li", {}, s)) : []);
  fill($("warnings"), [...new Set([...(summary.warnings ?? []), ...(summary.changes?.warnings ?? [])])].map((w) => el("li", {}, w)));
  const files = { report: "report.html", model: "model.json", diagnosis: "diagnosis.json", recording: "recording.h5" };
  fill($("links"), Object.entries(files).map(([name, file]) => el("a", { href: run.links[name], "data-download": `${run.id}-${file}` }, `Save ${name}`)));
  for (const id of ["axis-choice", "frf", "missing"]) $(id).hidden = true;
  fill($("causes"), []);
  fill($("parameters"), []);
  const [model, plots] = await Promise.all([get(run.links.model), get(run.links.plots).catch(() => null)]);
  if (shown !== run.id) return;
  parameters(model, summary.changes);
  if (plots) pictures(plots);
}

function parameters(model, changes) {
  const known = new Map([...(changes?.parameters ?? []), ...(changes?.effects ?? [])].map((p) => [p.parameter, p]));
  const u = model.units ?? {}, lines = [];
  const add = (label, name, e, unit) => lines.push({ label, name, e, unit });
  for (const b of model.branches) {
    b.masses.forEach((e, i) => add(`${b.axis} mass ${i + 1}${i === b.masses.length - 1 && i ? " (final)" : ""}`, `${b.axis}.mass.${i + 1}`, e, u.mass));
    b.springs.forEach((e, i) => add(`${b.axis} spring ${i + 1}`, `${b.axis}.spring.${i + 1}`, e, u.stiffness));
    b.dampers.forEach((e, i) => add(`${b.axis} damper ${i + 1}`, `${b.axis}.damper.${i + 1}`, e, u.damping));
  }
  for (const c of model.couplings ?? []) add(`${c.between.join("–")} inertia coupling`, `${c.between.join("-")}.coupling`, c, u.mass);
  for (const x of model.effects ?? []) for (const [n, e] of Object.entries(x.parameters))
    add(`${x.axis} ${x.cause.replaceAll("_", " ")}${x.element ? ` (${x.element})` : ""}: ${n.replaceAll("_", " ")}`, [x.axis, x.cause, x.element, x.other_axis, n].filter(Boolean).join("."), e, e.unit);
  const change = (name) => {
    const p = known.get(name);
    if (!p) return "";
    if (p.status === "changed") return `● changed ${p.difference > 0 ? "+" : "−"}${estimate(Math.abs(p.difference), p.difference_std)}`;
    const seen = p.detectable_percent > 0 ? `; ${fmt(p.detectable_percent, 2)} % would have been seen` : "";
    if (p.status === "unchanged") return `○ unchanged within ±${fmt(p.within_percent, 2)} %${seen}`;
    return `? cannot tell${p.reason ? `: ${p.reason}` : ""}`;
  };
  const head = ["Parameter", "Value ± 1 std. dev.", "Unit", ...(known.size ? ["Change"] : [])];
  table($("parameters"), head, lines.map((l) => {
    const value = estimate(l.e.value, l.e.std) + (l.e.std == null ? " (uncertainty unknown)" : "");
    return { cells: [el("b", {}, l.label), value, l.unit ?? "", ...(known.size ? [change(l.name)] : [])], changed: known.get(l.name)?.status === "changed" };
  }));
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

function pictures(plots) {
  const missing = new Map((plots.missing_torque ?? []).map((m) => [m.axis, m]));
  if (plots.frf?.length) {
    $("axis-choice").hidden = false;
    $("frf").hidden = false;
    chooser($("frf-axis"), plots.frf, (entry) => entry.axis, (entry) => { response(entry); frequency(missing.get(entry.axis)); });
  }
  for (const view of plots.views ?? []) $("causes").append(cause(view));
}

function response(entry) {
  const { before, after } = entry.simulated, series = [];
  // The wide line lies under the narrow one: where both agree, both are seen.
  if (before) series.push({ label: "simulated before", x: entry.frequency_hz, y: before.magnitude, colour: "--before", dash: 0, width: 7 });
  if (after) series.push({ label: "simulated with the causes", x: entry.frequency_hz, y: after.magnitude, colour: "--after", dash: 0, width: 2.5 });
  if (entry.measured) series.push({ label: "measured", x: entry.measured.frequency_hz, y: entry.measured.magnitude, colour: "--measured", points: true });
  curves($("frf-plot"), { x: "frequency [Hz]", y: `position per torque [${entry.unit}]`, series, peaks: entry.peaks_hz });
}

function frequency(m) {
  const there = Boolean(m?.excited?.frequency_hz?.length);
  $("missing").hidden = !there;
  if (!there) return;
  const series = [{ label: "missing, shaken lines", x: m.excited.frequency_hz, y: m.excited.before, colour: "--before", dash: 0 }];
  if (m.silent?.frequency_hz?.length) series.push({ label: "missing, lines between", x: m.silent.frequency_hz, y: m.silent.before, colour: "--third", dash: 1, width: 1.5 });
  series.push({ label: "noise floor", x: m.frequency_hz, y: m.noise_floor, colour: "--quiet", dash: 2 });
  curves($("missing-plot"), { x: "frequency [Hz]", y: `torque [${m.unit}]`, series });
}

// One cause: its torque over what it depends on, then over the rest, then over frequency.
function cause(view) {
  const target = el("div", { class: "plot" }), buttons = el("div", { class: "choices", role: "group", "aria-label": "Missing torque over" });
  const name = view.cause ? `${view.axis}: ${view.cause.replaceAll("_", " ")}${view.element ? ` at ${view.element === "mass 1" ? "the motor" : view.element}` : ""}` : `${view.axis}: not explained`;
  const fitted = view.sides.some((s) => s.fit), note = view.note ? ` (${view.note})` : "";
  const entries = [...view.sides, ...(view.spectrum?.frequency_hz?.length ? [{ what: "frequency" }] : [])];
  const draw = (side) => {
    if (side.what !== "frequency") {
      cloud(target, { x: side.x, y: side.y, fit: side.fit, line: side.what === view.own, xLabel: side.x_label, yLabel: view.y_label });
      return;
    }
    const s = view.spectrum, series = [{ label: "missing", x: s.frequency_hz, y: s.missing, colour: "--measured", dash: 0 }];
    if (s.left) series.push({ label: "left with the cause", x: s.frequency_hz, y: s.left, colour: "--before", dash: 1 });
    series.push({ label: "noise floor", x: s.frequency_hz, y: s.noise_floor, colour: "--quiet", dash: 2 });
    curves(target, { x: "frequency [Hz]", y: view.y_label, series });
  };
  const caption = `${name}. Dots: the torque the simulation misses${note}.${fitted ? " Orange: the fitted cause." : ""}`;
  const figure = el("figure", {}, [el("figcaption", {}, caption), buttons, target]);
  // Drawn when it has a width, which it has only on the page.
  queueMicrotask(() => chooser(buttons, entries, (e) => `over ${e.what}`, draw));
  return figure;
}
