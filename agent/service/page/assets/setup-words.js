/* Texts of the service in the words of the page: options of the command line by their labels, code in its own look. */
import { make } from "./dom.js";
import { known, say } from "./language.js";
import { seen } from "./setup-state.js";

/* Elements of a text in which code stands between backticks. */
export const prose = (text) => text.split("`").map((part, i) => (i % 2 ? make("code", {}, part) : part));

/* One text from several, each of which begins with a capital letter. */
export const sentences = (...texts) => texts.filter(Boolean).map((text) => text[0].toUpperCase() + text.slice(1)).join(". ");

/* The text with the label of a box in the place of an option, and the word of its choice. */
export function inPageWords(text) {
  return text.replaceAll(/--([a-z-]+)(?: ([a-z][a-z-]*|[\d.]*\d))?/g, (whole, option, value) => {
    const field = seen.fields.find(({ name }) => name === { class: "machine_class" }[option] || name === option.replaceAll("-", "_"));
    if (!field) return whole;
    const label = `“${say(`field.${field.name}`)}”`;
    if (!value) return label;
    const word = `${field.name}.${value}`;
    return /^\d/.test(value) ? `${label}: ${value},` : field.choices.includes(value) ? `${label}: ${known(word) ? say(word) : value},` : `${label} ${value}`;
  });
}
