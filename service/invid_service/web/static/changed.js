// What a person changed before the measurement: said first, answered first in the result.
import { $, $$, el, fill, fmt } from "./dom.js";
import { named, t } from "./texts.js";

const SIZES = { mass_kg: "changed-mass", arm_m: "changed-arm", inertia_kgm2: "changed-inertia" };
const subject = () => $$("#changed [name=changed]:checked")[0].value;
const show = () => {
  $("changed-axis-choice").hidden = !subject();
  $("changed-sizes").hidden = subject() !== "tool";
};
$("changed").addEventListener("change", show);

/** @param {Cell} cell */
export function offerChanged(cell) {
  const linear = cell.limits[0]?.torque_unit === "N";
  fill($("changed-axis"), [el("option", { value: "" }, t("changed.axis.any")), ...cell.axes.map((a) => el("option", { value: a }, a))]);
  for (const field of [SIZES.arm_m, SIZES.inertia_kgm2]) $(field).closest("label").hidden = linear;
  forgetChanged();
}
export function forgetChanged() {
  for (const id of ["changed-axis", ...Object.values(SIZES)]) $(id).value = "";
  $$("#changed [name=changed]")[0].checked = true;
  $("changed").open = false;
  show();
}
/** @returns {{ changed?: Api["StatedChange"] }} */
export function changed() {
  /** @type {any} */
  const said = { what: subject() };
  if (!said.what) return {};
  if ($("changed-axis").value) said.axis = $("changed-axis").value;
  if (said.what === "tool") for (const [name, id] of Object.entries(SIZES)) if ($(id).value) said[name] = Number($(id).value);
  return { changed: said };
}

// "another tool on A2, about 1.3 kg at 1 m"
/** @param {Run} run */
export function saidBefore(run) {
  const said = run.changed;
  if (!said) return "";
  const sizes = [said.mass_kg && `${fmt(said.mass_kg)} kg`, said.arm_m && `${fmt(said.arm_m)} m`, said.inertia_kgm2 && `${fmt(said.inertia_kgm2)} kg·m²`].filter(Boolean);
  return t("changed.said", { what: [named("changed", said.what), said.axis, ...sizes].filter(Boolean).join(", ") });
}
