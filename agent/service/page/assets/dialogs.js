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
export function asked(title, confirm, ...fields) {
  return opened(title, confirm, make("button", { type: "button", onclick: () => byId("dialog").close() }, say("dialog.cancel")), fields);
}

/* Shows something that asks for nothing. */
export const shown = (title, ...fields) => opened(title, say("dialog.close"), null, fields);

function opened(title, confirm, cancel, fields) {
  const dialog = byId("dialog");
  return new Promise((resolve) => {
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

export async function askToken(why) {
  const field = make("input", { type: "password", name: "token", required: true, autocomplete: "off", value: token() ?? "" });
  const given = await asked(say("token.title"), say("token.keep"), make("p", {}, why),
    make("label", {}, say("token.name"), field));
  if (given === null) return false;
  keepToken(given.get("token").trim());
  return true;
}

export async function askConfirmation(title, text, confirm) {
  return (await asked(title, confirm, make("p", {}, text))) !== null;
}

const KINDS = ["calibrate", "verify", "nightly"];

/* Shows the fields of the chosen kind of run only. A hidden field is disabled, so that it is not sent. */
function showFieldsOf(form, kind) {
  for (const field of form.querySelectorAll("[data-for]")) {
    const used = field.dataset.for.split(" ").includes(kind);
    field.hidden = !used;
    for (const input of field.querySelectorAll("input, select")) input.disabled = !used;
  }
}

function ofKinds(kinds, field) {
  field.dataset.for = kinds;
  return field;
}

const option = (value, text) => make("option", { value }, text);
const fromSettings = (value) => option("", value ? say("start.from_settings_value", { value }) : say("start.from_settings"));

/* The stations of a calibration, of which some may be chosen, and the one of a run at a single station. */
function stationFields({ stations_mm: places, stations, standing_at: standing }) {
  if (places.length < 2) return [];
  const numbers = places.map((_, index) => index + 1);
  const several = make("fieldset", { className: "stations" }, make("legend", {}, say("start.stations")), ...numbers.map((one) =>
    make("label", { className: "check" }, make("input", { type: "checkbox", name: "stations", value: one, checked: stations.includes(one) }), String(one))));
  const single = make("label", {}, say("start.station"), make("select", { name: "station" }, fromSettings(standing),
    ...numbers.map((one) => option(one, String(one)))));
  return [ofKinds("calibrate", several), ofKinds("verify nightly", single)];
}

/* Stations of the request; null if they are those of the settings. */
function chosenStations(given, machine) {
  if (given.get("station")) return [Number(given.get("station"))];
  const chosen = given.getAll("stations").map(Number);
  return chosen.length === 0 || chosen.join() === machine.stations.join() ? null : chosen;
}

/* Resolves with the body of `POST /api/start`, or null. The person who confirms is at the machine. */
export async function askStart(machine) {
  const kinds = KINDS.map((kind, i) =>
    make("label", { className: "check" }, make("input", { type: "radio", name: "kind", value: kind, checked: i === 0, onchange: ({ target }) => showFieldsOf(target.form, kind) }),
      make("span", {}, make("b", {}, say(`kind.${kind}`)), " ", say(`kind.${kind}.is`))));
  const set = make("select", { name: "position_set" }, fromSettings(machine.position_set), ...machine.position_sets.map((name) => option(name, name)));
  const slot = make("input", { name: "slot", type: "number", min: 1, max: 1440, step: 1, placeholder: String(machine.slot_minutes ?? "") });
  const full = make("input", { type: "checkbox", name: "full", checked: machine.full_allowed ?? false });
  const consent = make("input", { type: "checkbox", name: "consent", required: true });
  const options = make("div", { className: "options" },
    ofKinds("calibrate", make("label", {}, say("start.position_set"), set)), ...stationFields(machine),
    ofKinds("nightly", make("label", {}, say("start.slot"), slot)),
    ofKinds("nightly", make("label", { className: "check" }, full, say("start.full_allowed"))));
  const confirmed = asked(say("start.title"), say("start.confirm"), make("div", { className: "kinds" }, ...kinds), options,
    make("label", { className: "check" }, consent, make("b", {}, say("start.consent"))));
  showFieldsOf(consent.form, KINDS[0]);
  const given = await confirmed;
  if (given === null) return null;
  const kind = given.get("kind"), stations = chosenStations(given, machine);
  return {
    kind,
    source: "page",
    consent: given.has("consent"),
    ...(stations ? { stations } : {}),
    ...(given.get("position_set") ? { position_set: given.get("position_set") } : {}),
    ...(given.get("slot") ? { slot_minutes: Number(given.get("slot")) } : {}),
    ...(kind === "nightly" ? { full_allowed: given.has("full") } : {}),
  };
}

export function showKeys(keys) {
  const rows = keys.map(([key, message]) => make("tr", {}, make("th", {}, make("kbd", {}, key)), make("td", {}, say(message))));
  return shown(say("keys.title"), make("table", { className: "keys" }, make("tbody", {}, ...rows)));
}
