// How far a run is: what is done or weighed now, what is left, and that it still looks.
import { $, fmt, seconds } from "./dom.js";
import { age, blind } from "./store.js";
import { named, phase, t } from "./texts.js";

const LOOKING_S = 5;
const seen = { key: "", since: 0 };
// No more exact than it is known.
const coarse = (s) => (s < 20 ? s : Math.ceil(s / (s < 100 ? 5 : 30)) * (s < 100 ? 5 : 30));

/** @param {Pick<Now, "run" | "state" | "progress" | "cause" | "axis" | "phase" | "frequency" | "eta_s" | "motion_left_s">} c */
export function showProgress(c) {
  const key = `${c.run} ${c.state}`, now = Date.now();
  if (seen.key !== key) Object.assign(seen, { key, since: now });
  $("bar").value = c.progress;
  const what = c.cause ? [t(c.axis ? "progress.weighing_on" : "progress.weighing", { cause: named("cause", c.cause), axis: c.axis })]
    : [phase(c.phase), c.axis && !c.phase.includes(c.axis) && t("progress.axis", { axis: c.axis }), c.frequency && `${fmt(c.frequency, 3)} Hz`];
  const parts = [t("progress.percent", { n: Math.round(c.progress * 100), what: what.filter(Boolean).join(", ") })];
  const [of, known] = c.eta_s != null ? ["progress.left", c.eta_s] : ["progress.motion_left", c.motion_left_s], left = known == null || blind() ? 0 : known - age();
  if (left > 0.5) parts.push(t(of, { time: seconds(coarse(left)) }));
  else if (!blind() && c.state === "analysing" && now - seen.since > 1000 * LOOKING_S) parts.push(t("progress.looking", { time: seconds((now - seen.since) / 1000) }));
  const text = parts.join(", ");
  if ($("phase").textContent !== text) $("phase").textContent = text;
}
