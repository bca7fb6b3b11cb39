/* Language of the page. All texts come from catalogues, such as messages.json, in both languages. */
const KEPT_AS = "volcal.language";
const catalogue = {};
let language = "en";
const listeners = new Set();

export async function loadWords(...names) {
  for (const name of ["messages.json", ...names]) Object.assign(catalogue, await (await fetch(`/assets/${name}`)).json());
  const wished = localStorage.getItem(KEPT_AS) ?? navigator.language.slice(0, 2);
  language = languages().includes(wished) ? wished : "en";
  document.documentElement.lang = language;
}

/* Adds messages that the service states itself. */
export const addWords = (words) => Object.assign(catalogue, words);

export const languages = () => Object.keys(Object.values(catalogue)[0] ?? { en: "" });
export const languageNow = () => language;

export function speak(wished) {
  language = wished;
  localStorage.setItem(KEPT_AS, wished);
  document.documentElement.lang = wished;
  for (const listener of listeners) listener();
}

export const onLanguage = (listener) => listeners.add(listener);

/* Returns the message `key` with each `{name}` replaced. A missing key is shown as it is; a test finds it first. */
export function say(key, values = {}) {
  const text = catalogue[key]?.[language] ?? key;
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

/* Returns the English message, for comparison with texts of the service, which are English. */
export const inEnglish = (key) => catalogue[key]?.en ?? "";
export const known = (key) => key in catalogue;

export function number(value, digits = 1) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  return new Intl.NumberFormat(language, { minimumFractionDigits: digits, maximumFractionDigits: digits, signDisplay: "negative" }).format(value);
}

export function instant(utc) {
  if (!utc) return "–";
  return `${day(utc)} ${timeOfDay(utc)}`;
}

/* Date and time without seconds. */
export const minute = (utc) => (utc ? `${day(utc)} ${timeOfDay(utc, "short")}` : "–");

export function day(utc) {
  const at = new Date(utc), two = (value) => String(value).padStart(2, "0");
  return say("date.day", { year: at.getFullYear(), month: two(at.getMonth() + 1), day: two(at.getDate()) });
}

/* A date that is stated as "2026-12-11" (UTC): the same day in every time zone. */
export function dayOfDate(date) {
  const [year, month, day] = date.split("-");
  return say("date.day", { year, month, day });
}

export const timeOfDay = (utc, timeStyle = "medium") => new Intl.DateTimeFormat(language, { timeStyle, hourCycle: "h23" }).format(new Date(utc));

/* Names the button that leads to the other language, in that language. */
export function nameLanguage(other) {
  const button = document.getElementById("language");
  button.textContent = other.toUpperCase();
  button.lang = other;
  button.setAttribute("aria-label", say("language.change"));
}

/* Translates the elements that name their message in `data-text` (content) or `data-label` (accessible name). */
export function translate(root = document) {
  for (const element of root.querySelectorAll("[data-text]")) element.textContent = say(element.dataset.text);
  for (const element of root.querySelectorAll("[data-label]")) {
    element.setAttribute("aria-label", say(element.dataset.label));
    element.title = say(element.dataset.label);
  }
}
