/* Texts that the service makes in English, in the language of the page. The catalogue and the rules are those of
   agent/language/sentences.py; a test compares what both make of each sentence. */
import { languageNow } from "./language.js";

const PLACE = /\{(\w+)\}/g;
const WHOLE_ERROR = /^(?<message>.+?) \((?<places>[a-z_]+ [^()]+)\)(?:\. (?<hint>.+))?$/s;
const SEPARATORS = ["; ", ". ", ", "];
const DECIMAL = /(?<![\p{L}\p{N}_./:])(?<![\p{L}_]-)([+\-−]?\d+)\.(\d+)(?![\p{L}\p{N}_./:]*[\p{L}\p{N}_/:])/gu;
const INSTANT = /(?<![\p{L}\p{N}_./:-])(\d{4})-(\d{2})-(\d{2})(?:[T ](\d{2}:\d{2}(?::\d{2})?)(?:\.\d+)?|(?![\p{L}\p{N}_./:-]*[\p{L}\p{N}_/]))(?![\dT-])/gu;

let sentences = [], catalogue = {};
const remembered = new Map(), MOST_REMEMBERED = 2000;

export async function loadSentences() {
  catalogue = await (await fetch("/assets/german.json")).json();
  sentences = Object.entries(catalogue).map(sentenceOf).sort((one, other) => other.letters - one.letters);
}

/* Returns a text of the service in the language of the page; what the catalogue does not have stays in English. */
export const told = (text) => (languageNow() === "de" && text ? german(text) : text ?? "");

function sentenceOf([english, words]) {
  const parts = english.split(/\{(\w+)\}/), literals = parts.filter((_, i) => i % 2 === 0);
  const longest = literals.reduce((one, other) => (other.length > one.length ? other : one));
  return { words, literals, names: parts.filter((_, i) => i % 2), letters: literals.join("").length, needed: longest.slice(1), pattern: null };
}

function filled(sentence, text) {
  if (!text.includes(sentence.needed)) return null;
  sentence.pattern ??= new RegExp(`^${sentence.literals.map(eitherCaseFirst).join("(.*?)")}$`, "s");
  const found = sentence.pattern.exec(text);
  return found && Object.fromEntries(sentence.names.map((name, i) => [name, found[i + 1]]));
}

const escaped = (text) => text.replaceAll(/[.*+?^${}()|[\]\\/-]/g, "\\$&");
const eitherCaseFirst = (literal) => (/^\p{L}/u.test(literal) ? `[${literal[0].toUpperCase()}${literal[0].toLowerCase()}]${escaped(literal.slice(1))}` : escaped(literal));

export function german(text) {
  if (remembered.size >= MOST_REMEMBERED) remembered.clear();
  if (!remembered.has(text)) remembered.set(text, found(text) ?? composed(text) ?? withGermanNumbers(text));
  return remembered.get(text);
}

function found(text) {
  if (Object.hasOwn(catalogue, text)) return catalogue[text];
  for (const sentence of sentences) {
    const values = filled(sentence, text);
    if (values && !Object.values(values).includes(text)) return sentence.words.replaceAll(PLACE, (_, name) => german(values[name]));
  }
  return null;
}

/* An error in one line, or a text of several parts of which at least one is known. */
function composed(text) {
  const error = WHOLE_ERROR.exec(text)?.groups;
  if (error && german(error.message) !== error.message) return `${german(error.message)} (${withGermanNumbers(error.places)})${error.hint ? `. ${german(error.hint)}` : ""}`;
  for (const separator of SEPARATORS) {
    const parts = text.split(separator), words = parts.length > 1 ? parts.map(german) : [];
    if (words.some((one, i) => one !== withGermanNumbers(parts[i]))) return words.join(separator);
  }
  return null;
}

const withGermanNumbers = (text) => text.replaceAll(INSTANT, (_, year, month, day, time) => `${day}.${month}.${year}${time ? ` ${time}` : ""}`).replaceAll(DECIMAL, "$1,$2");
