/* Notices: confirmation of a request, shown for 5 s; problems stay until the next notice. */
import { byId, make } from "./dom.js";
import { known, say } from "./language.js";
import { Refused } from "./requests.js";
import { told } from "./sentences.js";

const SHOWN_MS = 5000;
let timer = null;

export function showDone(key) {
  show("done", say(key), "");
  timer = setTimeout(hide, SHOWN_MS);
}

/* Sign that a request is on its way; it stays until the answer replaces it. */
export const showSent = (key) => show("sent", say(key), "");

/* Warning that stays until the next notice. */
export const showWarning = (key) => show("problem", say(key), "");

/* Shows a refusal; `nodes` makes the elements of its text. */
export function showProblem(error, nodes = (text) => [text]) {
  if (!(error instanceof Refused)) throw error;
  const { status, title, detail, hint } = error.problem;
  if (known(`problem.${title}`)) return show("problem", say(`problem.${title}`), "", nodes);
  const own = `problem.${status}`;
  return show("problem", known(own) ? say(own) : told(detail), known(own) && status === 409 ? [detail, hint].filter(Boolean).map(told).join(" – ") : told(hint), nodes);
}

export const hide = () => byId("said").replaceChildren();

function show(look, title, text, nodes = (whole) => [whole]) {
  clearTimeout(timer);
  const said = byId("said");
  said.dataset.look = look;
  said.replaceChildren(make("b", {}, ...nodes(title)), ...nodes(text));
}
