/* Set-up of a new machine: one step after the other; the service keeps what was stated. */
import { askToken } from "./dialogs.js";
import { byId, make } from "./dom.js";
import { languageNow, languages, loadWords, nameLanguage, onLanguage, say, speak, translate } from "./language.js";
import { keepToken } from "./requests.js";
import { connectPanel, drawingPanel, fingerPanel, jogPanel, rest, wrongAxes } from "./setup-checks.js";
import { fieldOf, placedByHand } from "./setup-fields.js";
import { reviewPanel } from "./setup-review.js";
import { loadSentences } from "./sentences.js";
import { load, onState, seen, settled } from "./setup-state.js";
import { inPageWords, prose, sentences } from "./setup-words.js";
import { openTheme } from "./theme.js";

const left = new Set();
let step = "machine", fields = [], panels = [];

/* The address that the terminal shows ends with the token; it is taken out of the address at once. */
function takeToken() {
  const found = /^#token=(.+)$/.exec(location.hash);
  if (!found) return;
  keepToken(decodeURIComponent(found[1]));
  history.replaceState(null, "", "/");
}

function panelsOf(name) {
  const redraw = () => update();
  return { controller: () => [connectPanel()], chain: () => [drawingPanel(), jogPanel(redraw)], probe: () => [fingerPanel()], review: () => [reviewPanel()] }[name]?.() ?? [];
}

function show(name) {
  rest();
  step = name;
  fields = seen.fields.filter((field) => field.step === name).map(fieldOf);
  panels = panelsOf(name);
  byId("step").replaceChildren(make("h2", { id: "step-title" }, say(`step.${name}`)), make("p", { className: "remark", id: "about" }),
    ...(name === "machine" ? [make("p", { className: "remark" }, say("setup.directory", { directory: seen.now.directory }))] : []),
    make("div", { id: "general" }), ...(fields.length ? [make("div", { className: "fields" }, ...fields.map(({ element }) => element))] : []),
    ...panels.map(({ element }) => element));
  update();
}

/* Shows the state; what had the focus keeps it, also if it was made anew. */
function update(needed = false) {
  const focused = document.activeElement?.id;
  refresh(needed);
  if (focused && document.activeElement !== byId(focused)) byId(focused)?.focus({ preventScroll: true });
}

function refresh(needed) {
  byId("about").replaceChildren(...prose(say(step === "mount" && placedByHand() ? "about.by_hand" : `about.${step}`)));
  for (const field of fields) field.update(needed);
  for (const panel of panels) panel.update();
  const general = seen.now.problems[""];
  byId("general").replaceChildren(...(general ? [make("div", { className: "panel problem" }, make("b", {}, say("setup.general")), make("p", {}, ...prose(inPageWords(sentences(general.detail, general.hint)))))] : []));
  byId("steps").replaceChildren(...seen.steps.map((name, i) => {
    const done = finished(name), title = done ? say("setup.step_done", { step: say(`step.${name}`) }) : say(`step.${name}`);
    return make("button", { id: `to-${name}`, "data-number": String(i + 1), "data-done": done ? "true" : null, "aria-current": name === step ? "step" : null,
      onclick: () => go(name), title, ariaLabel: title }, make("span", {}, say(`step.${name}`)));
  }));
  byId("back").disabled = step === seen.steps[0];
  byId("next").disabled = step === seen.steps.at(-1);
  document.title = `${say(`step.${step}`)} – ${say("setup.title")}`;
}

/* A step is finished once it was left with nothing wrong or missing in it; the last one once the files are written. */
function finished(name) {
  if (name === "review") return seen.now.written !== null;
  const own = seen.fields.filter((field) => field.step === name).map((field) => field.name);
  const wrongAxis = name === "chain" && wrongAxes().length > 0;
  return left.has(name) && !wrongAxis && !own.some((field) => field in seen.now.problems || seen.now.missing === field);
}

function go(name) {
  left.add(step);
  show(name);
  byId("step").scrollTop = 0;
  byId("step").focus();
}

/* The next step, once nothing that this one asks for is wrong or missing. */
async function next() {
  document.activeElement?.blur();
  await settled();
  update(true);
  const wrong = fields.find(({ name }) => name in seen.now.problems || seen.now.missing === name);
  if (wrong) wrong.element.querySelector("input, select").focus();
  else go(seen.steps[seen.steps.indexOf(step) + 1]);
}

function words() {
  const other = languages().find((language) => language !== languageNow()) ?? languageNow();
  translate();
  nameLanguage(other);
  byId("language").onclick = () => speak(other);
}

takeToken();
await Promise.all([loadWords("setup-messages.json"), loadSentences()]);
openTheme();
words();
await load();
onState(() => update());
onLanguage(() => {
  words();
  if (!seen.finished) show(step);
});
byId("back").addEventListener("click", () => go(seen.steps[seen.steps.indexOf(step) - 1]));
byId("next").addEventListener("click", next);
byId("token").addEventListener("click", () => askToken(say("setup.token_why")));
show(step);
