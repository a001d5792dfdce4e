// Tuned values into the drives: a list of old and new, the robot's name by a person, then a measurement of the loops, and the way back.
import { get, post } from "./api.js";
import { ask } from "./ask.js";
import { $, button, el, fill, fmt, table } from "./dom.js";
import { spoken } from "./spoken.js";
import { t } from "./texts.js";
import { who } from "./who.js";

const LONG_MS = 120000; // slow drives take their time
/** @type {{ guarded: Function, verify: (run: string, pressed: any) => Promise<void> }} */
let acts = null;
export function onApply(given) { acts = given; }
const address = (run) => `/models/tune/${run}/apply`;

// Below the values of a run: what would be written, once somebody wants to see it.
/** @param {string} run */
export function offerApply(run) {
  const place = el("section", { id: "apply", class: "advice" }, [el("h4", {}, t("apply.title")), el("p", {}, t("apply.note"))]);
  const look = button(t("apply.look"), acts.guarded(() => list(run, look.parentElement)), { id: "apply-look" });
  place.append(el("p", { class: "actions" }, [look, ...beside(run)]));
  return place;
}

// Measuring and the way back stand beside it whatever was done here: somebody may come back to this page.
function beside(run) {
  const verify = button(t("apply.verify"), acts.guarded(() => acts.verify(run, verify)), { id: "apply-verify", "data-acts": "" });
  const undo = button(t("apply.undo"), acts.guarded(() => back(run, undo)), { id: "apply-undo" });
  return [verify, undo];
}

async function list(run, place) {
  const found = await post(address(run), {}, {}, LONG_MS), made = el("table", { class: "stacks", id: "apply-list" });
  const value = (v) => fmt(v, 4);
  table(made, ["axis", "object", "old", "new"].map((h) => t(`apply.${h}`)), found.changes.map((c) => ({ cells: [el("b", {}, c.axis), el("span", { lang: "en" }, `${c.object} ${c.name}`), value(c.old), `${value(c.new)} ${c.unit}`] })));
  const said = found.said.map((s) => spoken("li", s));
  $("apply-found")?.remove();
  place.after(el("div", { id: "apply-found" }, [found.changes.length ? el("div", { class: "scroll", role: "region", "aria-label": t("apply.title") }, [made]) : el("p", {}, t("apply.nothing")), said.length ? el("ul", { class: "reasons" }, said) : null]));
  if (!found.changes.length) return;
  const name = await ask($("apply-found"), { title: t("apply.ask"), text: t("apply.ask.text", { robot: found.robot, n: found.changes.length }), label: t("apply.name"), yes: t("apply.write"), least: 1 });
  if (name === null) return;
  const done = await post(address(run), { token: found.token, name, ...who() }, {}, LONG_MS);
  fill($("apply-found"), [el("p", { class: "lead", role: "status" }, t("apply.done", { n: done.written }))]);
}

async function back(run, beside_) {
  const robot = (await post(address(run), {}, {}, LONG_MS)).robot;
  const name = await ask(beside_.parentElement, { title: t("apply.undo"), text: t("apply.undo.text", { robot }), label: t("apply.name"), yes: t("apply.undo.yes"), least: 1 });
  if (name === null) return;
  const done = await post(address(run), { undo: true, name, ...who() }, {}, LONG_MS);
  $("apply-found")?.remove();
  beside_.parentElement.after(el("div", { id: "apply-found" }, [el("p", { class: "lead", role: "status" }, t("apply.undone", { n: done.written })), ...done.said.map((s) => spoken("p", s))]));
}

// The result of a measurement of the loops: figures of each axis, measured beside predicted, and the way back.
/** @param {Run} run */
export async function verified(run) {
  const found = await get(run.links.verification), made = el("table", { class: "stacks" });
  const both = (f, digits = 3) => `${fmt(f.measured, digits)} (${f.low === f.high ? fmt(f.low, digits) : `${fmt(f.low, digits)} … ${fmt(f.high, digits)}`})`;
  const ripple = (a) => (a.ripple.measured == null || a.rated_torque == null ? "–" : `${fmt(100 * a.ripple.measured / a.rated_torque, 2)} (${a.ripple.high == null ? "–" : fmt(100 * a.ripple.high / a.rated_torque, 2)})`);
  const move = (a) => `${fmt(1e3 * a.following.measured, 2)} m${a.unit} (${fmt(1e3 * a.following.high, 2)})`;
  table(made, ["axis", "peak", "gain", "phase", "move", "settling", "ripple"].map((h) => t(`verified.${h}`)), found.axes.map((a) => ({ changed: ["worse", "other"].includes(a.verdict), cells: [
    el("b", {}, a.axis), both(a.sensitivity), a.gain_margin.measured > 100 ? "> 100" : both(a.gain_margin), both(a.phase_margin), move(a), a.settling.measured == null ? "–" : both(a.settling, 2), ripple(a)] })));
  return el("section", { id: "verified", class: "advice" }, [el("h3", {}, t("verified.title")), el("p", { class: "quiet" }, t("verified.note")),
    el("div", { class: "scroll", role: "region", "aria-label": t("verified.title") }, [made]), el("p", { class: "actions" }, beside(run.verifies))]);
}
