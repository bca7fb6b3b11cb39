/* Fields of a step. A value is sent when it is left; what it means and what is wrong comes from the service. */
import { make } from "./dom.js";
import { known, say } from "./language.js";
import { inPageWords, prose, sentences } from "./setup-words.js";
import { change, seen } from "./setup-state.js";

const AXES = ["X", "Y", "Z"];
/* Fields whose problem is told by what the service found in a file. */
const DETAILED = new Set(["artefact", "position_set"]);
const NUMERIC = new Set(["number", "integer", "triple", "travels"]);

/* Returns the element of a field and a function that shows what the service says about it. */
export function fieldOf(field) {
  const make_ = { choice: choiceField, triple: tripleField, travels: travelsField }[field.kind] ?? textField;
  const { element, inputs, propose } = make_(field);
  const error = make("p", { className: "error", id: `error-${field.name}` });
  const help = make("p", { className: "help", id: `help-${field.name}` });
  element.append(help, error);
  for (const input of inputs) {
    input.setAttribute("aria-describedby", `help-${field.name} error-${field.name}`);
    input.addEventListener("change", () => change("answers", { answers: { [field.name]: element.valueNow() } }));
  }
  const title = element.querySelector("label, legend").firstChild;
  const update = (needed = false) => {
    title.textContent = titleOf(field);
    // Without a mount there is nothing to state about it; what was stated before stays in sight, with what is wrong about it.
    element.hidden = field.name === "shaft" && placedByHand() && !seen.now.answers.shaft;
    const problem = seen.now.problems[field.name];
    const missing = needed && seen.now.missing === field.name;
    propose(seen.now.proposals[field.name] ?? "");
    const read = field.name in READINGS ? reading(field.name) : "";
    help.textContent = read ? say("setup.read_value", { value: read }) : "";
    const boxes = wrongBoxes(problem, inputs, needed);
    const whole = missing || Boolean(problem && !problem.boxes.length);
    for (const input of inputs) input.setAttribute("aria-invalid", String(whole ? !(missing && input.value) : boxes.some(({ input: wrong }) => wrong === input)));
    error.replaceChildren(...(missing ? [say("setup.needed")] : whole ? inWords(field, problem) : [...new Set(boxes.map(textOf))].map((text) => make("span", { className: "line" }, text))));
    const optional = element.querySelector(".optional");
    if (optional) optional.hidden = seen.now.needed.includes(field.name);
  };
  return { element, update, name: field.name };
}

/* The boxes that alone are wrong. Of the two ends of a travel, what a person left empty is not called wrong; what is
   empty beside something stated is named once the step is left. */
function wrongBoxes(problem, inputs, needed) {
  const found = (problem?.boxes ?? []).map((box) => ({ ...box, input: inputs.find(({ name }) => name.endsWith(`-${box.box}`)) ?? inputs[0] }));
  return found.filter(({ word, input }) => (word === "empty" ? needed : !(["order", "length"].includes(word) && input.value === "")));
}

function textOf({ box, word, values }) {
  const [axis, end] = box.split("-");
  const text = say(`wrong.${word}`, values);
  if (!axis) return text;
  return `${axis}${end && !["order", "length"].includes(word) ? ` ${say(`setup.${end}`)}` : ""}: ${text}`;
}

function inWords(field, problem) {
  if (field.step === "artefact" && field.name !== "artefact" && seen.now.answers.artefact) return [say("wrong.beside_file")];
  const own = `wrong.field_${field.name}`;
  const text = known(own) ? say(own) : say(`expected.${field.kind}`);
  return DETAILED.has(field.name) ? [text, make("small", {}, ...prose(inPageWords(sentences(problem.detail, problem.hint))))] : [text];
}

/* Whether a person puts the artefact down; there is no mount then. */
export const placedByHand = () => (seen.now.answers.placement || seen.now.proposals.placement) === "by-hand";

function titleOf({ name }) {
  return placedByHand() && known(`placed.${name}`) ? say(`placed.${name}`) : say(`field.${name}`);
}

const labelOf = (field) => [titleOf(field), " ", make("span", { className: "optional" }, say("setup.optional"))];
const clean = (field, text) => (NUMERIC.has(field.kind) ? text.trim().replaceAll(",", ".") : text.trim());

function textField(field) {
  const input = make("input", { id: `field-${field.name}`, name: field.name, autocomplete: "off", value: seen.now.answers[field.name] ?? "" });
  if (NUMERIC.has(field.kind)) input.inputMode = "decimal";
  const element = make("div", { className: "field" }, make("label", { htmlFor: input.id }, ...labelOf(field)), input);
  element.valueNow = () => clean(field, input.value);
  return { element, inputs: [input], propose: (text) => (input.placeholder = text) };
}

function choiceField(field) {
  const none = make("option", { value: "" });
  const select = make("select", { id: `field-${field.name}`, name: field.name }, none,
    ...field.choices.map((choice) => make("option", { value: choice }, wordOf(field, choice))));
  select.value = seen.now.answers[field.name] ?? "";
  const wide = field.name === "machine_class" ? "wide" : "";
  const element = make("div", { className: `field ${wide}` }, make("label", { htmlFor: select.id }, ...labelOf(field)), select);
  element.valueNow = () => select.value;
  const propose = (value) => (none.textContent = value ? say("setup.proposed", { value: wordOf(field, value) })
    : say(seen.now.needed.includes(field.name) ? "setup.choose" : "setup.as_proposed"));
  return { element, inputs: [select], propose };
}

function wordOf(field, choice) {
  if (field.name === "machine_class") return `${choice}: ${say(`machine_class.${choice}`)}`;
  return known(`${field.name}.${choice}`) ? say(`${field.name}.${choice}`) : choice;
}

function tripleField(field) {
  const stated = (seen.now.answers[field.name] ?? "").split(" ");
  const inputs = AXES.map((axis, i) => make("input", { name: `${field.name}-${axis}`, inputMode: "decimal", autocomplete: "off", value: stated[i] ?? "" }));
  const element = make("fieldset", { className: "field" }, make("legend", {}, ...labelOf(field)),
    make("div", { className: "axes" }, ...AXES.map((axis, i) => make("label", {}, axis, inputs[i]))));
  element.valueNow = () => combined(inputs.map((input) => clean(field, input.value)), inputs.map((input) => input.placeholder));
  const propose = (text) => inputs.forEach((input, i) => (input.placeholder = text.split(" ")[i] ?? ""));
  return { element, inputs, propose };
}

/* What is left empty beside something stated is taken from the proposals, as they are shown there. */
function combined(values, proposals, empty = "?") {
  if (values.every((value) => value === "")) return "";
  return values.map((value, i) => value || proposals[i] || empty).join(" ");
}

function travelsField(field) {
  const stated = (seen.now.answers[field.name] ?? "").split(" ").map(endsOf);
  const ends = AXES.map((axis, i) => ["lowest", "highest"].map((end, k) => make("input", {
    name: `${field.name}-${axis}-${end}`, inputMode: "decimal", autocomplete: "off", ariaLabel: `${axis} ${say(`setup.${end}`)}`, value: stated[i]?.[k] ?? "" })));
  const element = make("fieldset", { className: "field wide" }, make("legend", {}, ...labelOf(field)),
    make("div", { className: "ends" }, make("span"), make("span", { className: "column" }, say("setup.lowest")), make("span", { className: "column" }, say("setup.highest")),
      ...AXES.flatMap((axis, i) => [make("b", {}, axis), ...ends[i]])));
  element.valueNow = () => travelText(field, ends);
  const propose = (text) => ends.forEach((pair, i) => endsOf(text.split(" ")[i] ?? "").forEach((part, k) => (pair[k].placeholder = part)));
  return { element, inputs: ends.flat(), propose };
}

const endsOf = (text) => (text.includes(":") ? text.split(":") : text ? ["0", text] : ["", ""]);

function travelText(field, ends) {
  const values = ends.map((pair) => pair.map((input) => clean(field, input.value)));
  if (values.flat().every((value) => value === "")) return "";
  return values.map(([low, high], i) => `${low || ends[i][0].placeholder || "0"}:${high || ends[i][1].placeholder || "?"}`).join(" ");
}

/* What was read from the controller, beside what is stated. */
const READINGS = { travel: "lower_mm", rapid: "rapid_mm_per_min", acceleration: "acceleration_mm_per_s2" };

function reading(name) {
  const { reading: found } = seen.now;
  if (!found) return "";
  const values = AXES.map((axis, i) => (name === "travel" ? `${axis} ${shown(found.lower_mm[i])} … ${shown(found.upper_mm[i])}` : `${axis} ${shown(found[READINGS[name]][i])}`));
  return values.join(", ");
}

export const shown = (value) => (value === null ? "–" : String(Math.round(value * 1000) / 1000));
