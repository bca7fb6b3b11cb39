/* Texts that the service makes in English, in the language of the page. The catalogue and the rules are those of
   agent/language/sentences.py; a test compares what both make of each sentence. */
import { languageNow } from "./language.js";

const PLACE = /\{(\w+)\}/g;
const WHOLE_ERROR = /^(?<message>.+?) \((?<places>[a-z_]+ [^()]+)\)(?:\. (?<hint>.+))?$/s;
const SEPARATORS = ["; ", ". ", ", "];
const DECIMAL = /(?<![\p{L}\p{N}_./:])(?<![\p{L}_]-)([+\-−]?\d+)\.(\d+)(?![\p{L}\p{N}_./:]*[\p{L}\p{N}_/:])/gu;
const INSTANT = /(?<![\p{L}\p{N}_./:-])(\d{4})-(\d{2})-(\d{2})(?:[T ](\d{2}:\d{2}(?::\d{2})?)(?:\.\d+)?|(?![\p{L}\p{N}_./:-]*[\p{L}\p{N}_/]))(?![\dT-])/gu;

let sentences = [], catalogue = {};
const remembered = new Map(), MOST_REMEMBERED = 2000, DEEPEST = 8;

export async function loadSentences() {
  catalogue = await (await fetch("/assets/german.json")).json();
  sentences = Object.entries(catalogue).map(sentenceOf).sort((one, other) => other.letters - one.letters);
}

/* Returns a text of the service in the language of the page; what the catalogue does not have stays in English. */
export const told = (text) => (languageNow() === "de" && text ? german(text) : text ?? "");

function sentenceOf([english, words]) {
  const parts = english.split(/\{(\w+)\}/), literals = parts.filter((_, i) => i % 2 === 0);
  const longest = literals.reduce((one, other) => (other.length > one.length ? other : one));
  return { words, literals, names: parts.filter((_, i) => i % 2), letters: literals.join("").length, needed: longest.slice(1) };
}

/* Each place is as short as the words after it permit, and the last one takes the rest. */
function filled({ literals, names, needed }, text) {
  if (!text.includes(needed) || !begins(text, literals[0])) return null;
  const last = literals.at(-1), values = [];
  let at = literals[0].length;
  if (!names.length) return at === text.length ? {} : null;
  for (const literal of literals.slice(1, -1)) {
    const place = text.indexOf(literal, at);
    if (place < 0) return null;
    values.push(text.slice(at, place));
    at = place + literal.length;
  }
  const end = text.length - last.length;
  if (end < at || !text.endsWith(last)) return null;
  return Object.fromEntries(names.map((name, i) => [name, [...values, text.slice(at, end)][i]]));
}

const begins = (text, literal) => !literal || (text.slice(0, 1).toLowerCase() === literal[0].toLowerCase() && text.startsWith(literal.slice(1), 1));

/* `deepest`: number of sentences that lie inside of each other at most. */
export function german(text, deepest = DEEPEST) {
  if (remembered.size >= MOST_REMEMBERED) remembered.clear();
  const key = `${deepest} ${text}`;
  if (!remembered.has(key)) remembered.set(key, found(text, deepest) ?? (deepest ? composed(text, deepest - 1) : null) ?? withGermanNumbers(text));
  return remembered.get(key);
}

function found(text, deepest) {
  if (Object.hasOwn(catalogue, text)) return catalogue[text];
  for (const sentence of deepest ? sentences : []) {
    const values = filled(sentence, text);
    if (values && !Object.values(values).includes(text)) return sentence.words.replaceAll(PLACE, (_, name) => (name === "said" ? values.said : german(values[name], deepest - 1)));
  }
  return null;
}

/* An error in one line, or a text of several parts of which at least one is known. */
function composed(text, deepest) {
  const error = WHOLE_ERROR.exec(text)?.groups, inside = (part) => german(part, deepest);
  if (error && inside(error.message) !== error.message) return `${inside(error.message)} (${withGermanNumbers(error.places)})${error.hint ? `. ${inside(error.hint)}` : ""}`;
  for (const separator of SEPARATORS) {
    const parts = text.split(separator), words = parts.length > 1 ? parts.map(inside) : [];
    if (words.some((one, i) => one !== withGermanNumbers(parts[i]))) return words.join(separator);
  }
  return null;
}

const withGermanNumbers = (text) => text.replaceAll(INSTANT, (_, year, month, day, time) => `${day}.${month}.${year}${time ? ` ${time}` : ""}`).replaceAll(DECIMAL, "$1,$2");
