// Values for the drives from a run's model: a button, then what they bring, a picture, files.
import { Problem, call, read } from "./api.js";
import { $, el, fill, fmt, table } from "./dom.js";
import { say } from "./said.js";
import { refused, spoken } from "./spoken.js";
import { t } from "./texts.js";
import { offerVerify } from "./verify.js";

const AGAIN_MS = 2000, SAVED = { "tuning-files": "tuning.zip", "tuning-page": "tuning.html" };
/** @type {Run} */
let of = null;

/** @param {Run} run */
export function offerTuning(run) {
  const same = of?.id === run.id;
  of = run;
  $("tune-card").hidden = Boolean(run.untrusted) || !run.summary || run.mode === "verify";
  if (same || $("tune-card").hidden) return;
  offered();
  if (run.tuned) look();
}

function offered() {
  fill($("tuned"), []);
  $("tune").hidden = false;
  $("tune-note").textContent = t("tune.note");
}

$("tune").addEventListener("click", async () => {
  const run = of;
  going();
  try { await call("POST", "/models/tune", { model: run.id }); } catch (error) { if (of === run) failed(error); return; }
  setTimeout(look, AGAIN_MS);
});

function going() {
  $("tune").hidden = true;
  $("tune-note").textContent = t("tune.going");
}

async function look() {
  const run = of;
  try {
    const answer = await call("GET", run.links.tuning), body = await read(answer);
    if (of !== run) return;
    if (answer.status === 202) { going(); setTimeout(look, AGAIN_MS); return; }
    await show(run, body);
  } catch (error) { if (of === run) failed(error); }
}

function failed(error) {
  offered();
  fill($("tuned"), [el("p", { class: "alarm" }, error instanceof Problem ? refused(error) : [t("page.unreachable")])]);
}

async function show(run, tuning) {
  $("tune").hidden = true;
  $("tune-note").textContent = t("tune.done", { draws: tuning.draws });
  const unit = `m${tuning.units.angle}`, made = el("table", { class: "stacks" });
  const pair = (a, of_) => `${of_(a.before)} → ${of_(a.after)}`, milli = (v) => (v == null ? "–" : fmt(1000 * v, 3));
  table(made, ["axis", "following", "load", "settling", "peak"].map((h) => t(`tune.${h}`, { unit })), tuning.axes.map((a) => ({ cells: [
    el("b", {}, a.axis), pair(a, (s) => milli(s.move.following)), pair(a, (s) => milli(s.move.at_load)),
    pair(a, (s) => (s.move.settling == null ? "–" : `${fmt(s.move.settling, 2)} s`)), pair(a, (s) => (s.margins.unstable ? t("tune.unstable") : fmt(s.margins.sensitivity, 3))),
  ] })));
  const torque = tuning.units.torque, angle = tuning.units.angle, gains = el("table");
  const gain = (v) => (v == null ? "–" : fmt(v, 3)), both = (a, key) => `${gain(a.before.gains[key])} → ${gain(a.after.gains[key])}`, share = (a, s) => fmt(100 * s.margins.ripple / a.rated_torque, 2);
  const notches = (a) => a.after.gains.notches.map((n) => `${fmt(n.frequency, 3)} Hz`).join(", ") || "–";
  const rows = {
    position_gain: (a) => both(a, "position_gain"), velocity_gain: (a) => both(a, "velocity_gain"), integral_time: (a) => both(a, "integral_time"), notches,
    ripple: (a) => (a.after.margins.ripple == null || a.rated_torque == null ? "–" : pair(a, (s) => share(a, s))), spread: (a) => a.spread.at_load.map(milli).join(" … "),
  };
  table(gains, [t("tune.values"), ...tuning.axes.map((a) => a.axis)], Object.entries(rows).map(([name, of_]) => ({ cells: [t(`tune.${name}`, { unit, torque, angle }), ...tuning.axes.map(of_)] })));
  const picture = el("div", { class: "scroll", role: "region", "aria-label": t("tune.picture") });
  const remarks = tuning.remarks.map((r) => spoken("li", r));
  fill($("tuned"), [
    el("div", { class: "scroll", role: "region", "aria-label": t("tune.title") }, [made]),
    el("div", { class: "scroll", role: "region", "aria-label": t("tune.values") }, [gains]), el("p", { class: "quiet" }, `${t("tune.before")} ${t("tune.before_is", { source: say(tuning.before) })}`),
    el("figure", {}, [el("figcaption", {}, t("tune.picture")), picture]),
    remarks.length ? el("ul", { class: "reasons" }, remarks) : null,
    run.cell ? offerVerify(run.id) : null,
    el("p", { class: "links" }, Object.entries(SAVED).map(([name, file]) => el("a", { href: run.links[name], "data-download": `${run.id}-${file}` }, t(name === "tuning-page" ? "tune.page" : "tune.files")))),
  ].filter(Boolean));
  const text = await (await call("GET", run.links["tuning-picture"])).text();
  const svg = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
  if (of !== run || svg.nodeName !== "svg") return;
  svg.removeAttribute("style"); // white paper is for a file of its own
  picture.append(document.importNode(svg, true));
}
