// How far a run is: what is done or weighed now, what is left, and that it still looks.
import { $, fmt, seconds } from "./dom.js";
import { age, blind } from "./store.js";
import { phase } from "./said.js";
import { and, named, t } from "./texts.js";

const SOON_S = 300;
// No more exact than it is known.
const coarse = (s) => (s < 20 ? s : Math.ceil(s / (s < 100 ? 5 : 30)) * (s < 100 ? 5 : 30));

/** @param {Pick<Now, "run" | "state" | "progress" | "cause" | "axis" | "phase" | "frequency" | "eta_s" | "motion_left_s" | "most_s" | "found" | "known">} c */
export function showProgress(c) {
  $("bar").value = moving(c);
  const what = c.cause ? [t(c.axis ? "progress.weighing_on" : "progress.weighing", { cause: named("cause", c.cause), axis: c.axis })]
    : [phase(c.phase), c.axis && !c.phase.includes(c.axis) && t("progress.axis", { axis: c.axis }), c.frequency && `${fmt(c.frequency, 3)} Hz`];
  const parts = [t("progress.percent", { n: Math.round(c.progress * 100), what: what.filter(Boolean).join(", ") })];
  write("phase", [...parts, ...left(c)].join(", "));
  write("found-so-far", c.state === "analysing" && c.found.length ? t("progress.found", { what: foundSoFar(c.found) }) : c.known ? t("progress.known", known(c.known)) : "");
}

const shown = { run: null, progress: 0, since: 0, value: 0 };
// Between two words the bar goes on as the time left says, never back, never to the end.
function moving(c) {
  const now = Date.now() / 1000;
  if (shown.run !== c.run) Object.assign(shown, { run: c.run, progress: c.progress, since: now, value: 0 });
  if (c.progress !== shown.progress) Object.assign(shown, { progress: c.progress, since: now });
  const rest = c.eta_s ?? c.motion_left_s, passed = now - shown.since;
  // a word this very instant that nothing is left is no share: the bar would stand at NaN for good
  const on = rest == null || blind() || passed + rest <= 0 ? 0 : (1 - c.progress) * passed / (passed + rest);
  shown.value = Math.max(shown.value, c.progress + 0.8 * on);
  return shown.value;
}

// How long it will take, in words; none where that is not known.
/** @param {Pick<Now, "state" | "eta_s" | "motion_left_s" | "most_s">} c */
export function left(c) {
  const [of, known] = c.eta_s != null ? ["progress.left", c.eta_s] : ["progress.motion_left", c.motion_left_s], rest = known == null ? 0 : known - age();
  if (blind()) return [];
  if (rest > 0.5) return [t(of, { time: seconds(coarse(rest)) })];
  if (c.state !== "analysing" || c.most_s == null) return [];
  const most = c.most_s - age(); // an end that is far away says nothing
  return [most < SOON_S ? t("progress.longer", { time: seconds(coarse(most)) }) : t("progress.still")];
}

// "friction on A1 and A2, play on A3".
function foundSoFar(found) {
  const axes = new Map();
  for (const { cause, axis, other_axis } of found) axes.set(cause, new Set([...(axes.get(cause) ?? []), other_axis ? `${axis}–${other_axis}` : axis]));
  return and([...axes].map(([cause, on]) => t("progress.found_on", { cause: named("cause", cause), axes: and([...on]) })));
}

const known = ({ relative_std, shown, asked }) => ({ percent: fmt(100 * relative_std, 2), shown, asked });

function write(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}
