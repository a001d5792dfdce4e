// A question within the page, below what it is about: a dialog would lie over STOP.
import { button, el } from "./dom.js";
import { t } from "./texts.js";

// Resolves with what was written (without a field: "yes"), or null. `least`: letters without which there is no yes.
export function ask(place, { title, text = "", label = null, yes, least = 1, secret = false }) {
  if (place.nextElementSibling?.matches("form.ask")) place.nextElementSibling.remove();
  return new Promise((resolve) => {
    const field = label && el("input", { type: secret ? "password" : "text", autocomplete: "off", spellcheck: "false", maxlength: "500" });
    const go = el("button", { type: "submit" }, yes), done = (answer) => { form.remove(); resolve(answer); };
    const form = el("form", { class: "ask advice", "aria-label": title, tabindex: "-1" }, [el("p", {}, [el("b", {}, title), text && ` ${text}`]),
      label && el("label", {}, [`${label} `, field]), el("p", { class: "actions" }, [go, !secret && button(t("ask.no"), () => done(null))])]);
    form.addEventListener("submit", (event) => { event.preventDefault(); done(field ? field.value.trim() : "yes"); });
    if (field && least) {
      const judge = () => { go.disabled = field.value.trim().length < least; };
      field.addEventListener("input", judge);
      judge();
    }
    place.after(form);
    if (!secret) (field ?? form).focus(); // a key is asked for by itself: no keyboard jumps up over the page
  });
}
