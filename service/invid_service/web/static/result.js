// The result: the sentence first, the pictures under it, the numbers under those.
import { get } from "./api.js";
import { cloud, curves } from "./plots.js";
import { el, estimate, fill, fmt, row } from "./dom.js";

const $ = (id) => document.getElementById(id);
const VERDICTS = {
  consistent: "The model agrees with the robot: nothing beyond noise.",
  explained: "The simulation lacked something, and the cause is found.",
  partly_explained: "Part of what the simulation lacks is found, something is left.",
  unexplained: "The simulation lacks something that no known cause explains.",
};
let shown = null;

export async function showResult(run, cell) {
  const card = $("result-card"), summary = run.summary;
  card.hidden = false;
  $("decide").hidden = run.state !== "awaiting_accept";
  $("decision").textContent = run.decision ? `Model ${run.decision.type} by ${run.decision.by}.` : "";
  if (shown === run.id) return;
  shown = run.id;
  const sentences = summary.sentences ?? [];
  $("sentence").textContent = sentences[0] ?? VERDICTS[summary.verdict] ?? summary.verdict;
  $("sentence").focus({ preventScroll: true });
  card.scrollIntoView({ block: "start" });
  $("changes-sentence").textContent = summary.changes ? `Compared with the model in force: ${summary.changes.sentence}` : "";
  const rest = sentences.slice(1);
  $("todo").hidden = !rest.length;
  fill($("sentences"), rest.map((s) => el("li", {}, s)));
  fill($("warnings"), [...new Set([...(summary.warnings ?? []), ...(summary.changes?.warnings ?? [])])].map((w) => el("li", {}, w)));
  const files = { report: "report.html", model: "model.json", diagnosis: "diagnosis.json", recording: "recording.h5" };
  fill($("links"), Object.entries(files).map(([name, file]) => el("a", { href: run.links[name], "data-download": `${run.id}-${file}` }, `Save ${name}`)));
  for (const id of ["frf", "missing"]) $(id).hidden = true;
  fill($("causes"), []);
  fill($("parameters"), []);
  const [model, plots] = await Promise.all([get(run.links.model), get(run.links.plots).catch(() => null)]);
  if (shown !== run.id) return;
  parameters(model, summary.changes);
  if (plots) pictures(plots);
}

function parameters(model, changes) {
  const known = new Map((changes?.parameters ?? []).map((p) => [p.parameter, p]));
  const u = model.units ?? {}, lines = [];
  const add = (label, name, e, unit) => lines.push({ label, name, e, unit });
  for (const b of model.branches) {
    b.masses.forEach((e, i) => add(`${b.axis} mass ${i + 1}${i === b.masses.length - 1 && i ? " (final)" : ""}`, `${b.axis}.mass.${i + 1}`, e, u.mass));
    b.springs.forEach((e, i) => add(`${b.axis} spring ${i + 1}`, `${b.axis}.spring.${i + 1}`, e, u.stiffness));
    b.dampers.forEach((e, i) => add(`${b.axis} damper ${i + 1}`, `${b.axis}.damper.${i + 1}`, e, u.damping));
  }
  for (const c of model.couplings ?? []) add(`${c.between.join("–")} inertia coupling`, `${c.between.join("-")}.coupling`, c, u.mass);
  for (const x of model.effects ?? []) for (const [n, e] of Object.entries(x.parameters))
    add(`${x.axis} ${x.cause.replaceAll("_", " ")}${x.element ? ` (${x.element})` : ""}: ${n.replaceAll("_", " ")}`, "", e, e.unit);
  const change = (name) => {
    const p = known.get(name);
    if (!p) return "";
    if (p.status === "changed") return `● changed ${p.difference > 0 ? "+" : "−"}${estimate(Math.abs(p.difference), p.difference_std)}`;
    if (p.status === "unchanged") return `○ unchanged within ±${fmt(p.within_percent, 2)} %`;
    return `? cannot tell${p.reason ? `: ${p.reason}` : ""}`;
  };
  const head = ["Parameter", "Value ± one standard deviation", "Unit", ...(known.size ? ["Change"] : [])];
  fill($("parameters"), [row("th", head), ...lines.map((l) => {
    const cells = [l.label, estimate(l.e.value, l.e.std) + (l.e.std == null ? " (uncertainty unknown)" : ""), l.unit ?? "", ...(known.size ? [change(l.name)] : [])];
    const tr = row("td", cells, { 3: "wrap" });
    if (known.get(l.name)?.status === "changed") tr.className = "changed";
    return tr;
  })]);
}

function pictures(plots) {
  if (plots.frf?.length) {
    $("frf").hidden = false;
    const draw = (entry) => {
      for (const b of $("frf-axis").children) b.setAttribute("aria-pressed", String(b.textContent === entry.axis));
      const { before, after } = entry.simulated, series = [];
      if (entry.measured) series.push({ label: "measured", x: entry.measured.frequency_hz, y: entry.measured.magnitude, colour: "--measured", points: true });
      if (before) series.push({ label: "simulated before", x: entry.frequency_hz, y: before.magnitude, colour: "--before", dash: 1 });
      if (after) series.push({ label: "simulated with the causes", x: entry.frequency_hz, y: after.magnitude, colour: "--after", dash: 0 });
      curves($("frf-plot"), { x: "frequency [Hz]", y: `position per torque [${entry.unit}]`, series, peaks: entry.peaks_hz });
    };
    fill($("frf-axis"), plots.frf.map((entry) => {
      const b = el("button", { type: "button" }, entry.axis);
      b.addEventListener("click", () => draw(entry));
      return b;
    }));
    draw(plots.frf[0]);
  }
  for (const cause of plots.causes ?? []) {
    const target = el("div", { class: "plot" });
    const name = cause.cause ? `${cause.axis}: ${cause.cause.replaceAll("_", " ")}${cause.element ? ` at ${cause.element}` : ""}` : `${cause.axis}: not explained`;
    $("causes").append(el("figure", {}, [el("figcaption", {}, `${name}. Dots: the torque the simulation misses${cause.fit ? "; line: the fitted cause" : ""}. ${cause.note ?? ""}`), target]));
    cloud(target, { x: cause.x, y: cause.y, fit: cause.fit, xLabel: cause.x_label, yLabel: cause.y_label });
  }
  const missing = (plots.missing_torque ?? []).filter((m) => m.excited?.frequency_hz?.length);
  if (missing.length) {
    $("missing").hidden = false;
    const hues = ["--after", "--before", "--third"], series = [];
    missing.forEach((m, i) => {
      series.push({ label: `${m.axis} missing`, x: m.excited.frequency_hz, y: m.excited.before, colour: hues[i % 3], dash: 0 });
      series.push({ label: `${m.axis} noise`, x: m.frequency_hz, y: m.noise_floor, colour: hues[i % 3], dash: 2 });
    });
    curves($("missing-plot"), { x: "frequency [Hz]", y: `torque [${missing[0].unit}]`, series });
  }
}
