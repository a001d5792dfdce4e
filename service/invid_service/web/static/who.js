// Who decides: a name that this browser remembers. Without one the service takes the key's.
import { $ } from "./dom.js";

const NAME = "invid-name";
$("by").value = localStorage.getItem(NAME) ?? "";
$("by").addEventListener("change", () => localStorage.setItem(NAME, $("by").value.trim()));

/** @returns {{ by?: string }} */
export function who() {
  const by = $("by").value.trim();
  return by ? { by } : {};
}
