/* Dialogs of the page. Abort has none: it is executed without confirmation. */
import { byId, make } from "./dom.js";
import { say } from "./language.js";
import { keepToken, token } from "./requests.js";

/* Everything except the dialog and the abort button is inert: no dialog ever covers that button. */
const rests = () => document.querySelectorAll(".top, main, .requests");

function open(dialog) {
  const former = document.activeElement;
  for (const part of rests()) part.inert = true;
  dialog.addEventListener("close", () => {
    for (const part of rests()) part.inert = false;
    former?.focus();
  }, { once: true });
  dialog.show();
  dialog.querySelector("input, button").focus();
}

addEventListener("keydown", (event) => {
  if (event.key === "Escape") byId("dialog").close();
});

/* Resolves with the form data if confirmed, otherwise with null. */
function asked(title, confirm, ...fields) {
  const dialog = byId("dialog");
  return new Promise((resolve) => {
    const cancel = make("button", { type: "button", onclick: () => dialog.close() }, say("dialog.cancel"));
    const form = make("form", { method: "dialog" }, make("h2", { id: "dialog-title" }, title), ...fields,
      make("div", { className: "actions" }, cancel, make("button", { type: "submit", className: "go big" }, confirm)));
    let given = null;
    form.addEventListener("submit", () => (given = new FormData(form)));
    dialog.addEventListener("close", () => resolve(given), { once: true });
    dialog.setAttribute("aria-labelledby", "dialog-title");
    dialog.replaceChildren(form);
    open(dialog);
  });
}

export async function askToken(why = "") {
  const field = make("input", { type: "password", name: "token", required: true, autocomplete: "off", value: token() ?? "" });
  const given = await asked(say("token.title"), say("token.keep"), make("p", {}, why || say("token.why")),
    make("label", {}, say("token.name"), field));
  if (given === null) return false;
  keepToken(given.get("token").trim());
  return true;
}

export async function askConfirmation(title, text, confirm) {
  return (await asked(title, confirm, make("p", {}, text))) !== null;
}

const KINDS = ["calibrate", "verify", "nightly"];

/* Resolves with the body of `POST /api/start`, or null. The person who confirms is at the machine. */
export async function askStart(machine) {
  const kinds = KINDS.map((kind, i) =>
    make("label", { className: "check" }, make("input", { type: "radio", name: "kind", value: kind, checked: i === 0 }),
      make("span", {}, make("b", {}, say(`kind.${kind}`)), " ", say(`kind.${kind}.is`))));
  const sets = make("input", { name: "position_set", placeholder: machine.position_set ?? "", list: "sets", autocomplete: "off" });
  const slot = make("input", { name: "slot", type: "number", min: 1, max: 1440, step: 1, placeholder: String(machine.slot_minutes ?? "") });
  const full = make("input", { type: "checkbox", name: "full", checked: machine.full_allowed ?? false });
  const consent = make("input", { type: "checkbox", name: "consent", required: true });
  const given = await asked(say("start.title"), say("start.confirm"), ...kinds,
    make("label", {}, say("start.position_set"), sets), make("label", {}, say("start.slot"), slot),
    make("label", { className: "check" }, full, say("start.full_allowed")),
    make("label", { className: "check" }, consent, make("b", {}, say("start.consent"))));
  if (given === null) return null;
  const kind = given.get("kind");
  const set = given.get("position_set").trim();
  return {
    kind,
    source: "page",
    consent: given.has("consent"),
    ...(set && kind === "calibrate" ? { position_set: set } : {}),
    ...(given.get("slot") && kind === "nightly" ? { slot_minutes: Number(given.get("slot")) } : {}),
    ...(kind === "nightly" ? { full_allowed: given.has("full") } : {}),
  };
}

export function showKeys(keys) {
  const rows = keys.map(([key, message]) => make("tr", {}, make("th", {}, make("kbd", {}, key)), make("td", {}, say(message))));
  return asked(say("keys.title"), say("dialog.close"), make("table", { className: "keys" }, make("tbody", {}, ...rows)));
}
