// The drives' own loops measured while they are closed, once the drives have a run's values: a button, then what came of it.
import { get } from "./api.js";
import { button, el, fmt, table } from "./dom.js";
import { t } from "./texts.js";

/** @type {{ guarded: Function, verify: (run: string, pressed: any) => Promise<void> }} */
let acts = null;
export function onVerify(given) { acts = given; }

/** @param {string} run */
export function offerVerify(run) {
  const verify = button(t("verify.title"), acts.guarded(() => acts.verify(run, verify)), { id: "verify", "data-acts": "" });
  return el("section", { class: "advice" }, [el("h4", {}, t("verify.title")), el("p", {}, t("verify.note")), el("p", { class: "actions" }, [verify])]);
}

// The result of a measurement of the loops: figures of each axis, measured beside predicted.
/** @param {Run} run */
export async function verified(run) {
  const found = await get(run.links.verification), made = el("table", { class: "stacks" });
  const both = (f, digits = 3) => `${fmt(f.measured, digits)} (${f.low === f.high ? fmt(f.low, digits) : `${fmt(f.low, digits)} … ${fmt(f.high, digits)}`})`;
  const ripple = (a) => (a.ripple.measured == null || a.rated_torque == null ? "–" : `${fmt(100 * a.ripple.measured / a.rated_torque, 2)} (${a.ripple.high == null ? "–" : fmt(100 * a.ripple.high / a.rated_torque, 2)})`);
  const move = (a) => `${fmt(1e3 * a.following.measured, 2)} m${a.unit} (${fmt(1e3 * a.following.high, 2)})`;
  table(made, ["axis", "peak", "gain", "phase", "move", "settling", "ripple"].map((h) => t(`verified.${h}`)), found.axes.map((a) => ({ changed: ["worse", "other"].includes(a.verdict), cells: [
    el("b", {}, a.axis), both(a.sensitivity), a.gain_margin.measured > 100 ? "> 100" : both(a.gain_margin), both(a.phase_margin), move(a), a.settling.measured == null ? "–" : both(a.settling, 2), ripple(a)] })));
  return el("section", { id: "verified", class: "advice" }, [el("h3", {}, t("verified.title")), el("p", { class: "quiet" }, t("verified.note")),
    el("div", { class: "scroll", role: "region", "aria-label": t("verified.title") }, [made])]);
}
