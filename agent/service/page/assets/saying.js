/* What the service has answered to a request, shown for a while; problems until something else is said. */
import { byId, make } from "./dom.js";
import { known, say } from "./language.js";
import { Refused } from "./requests.js";

const SHOWN_MS = 5000;
let timer = null;

export function tellDone(key) {
  show("done", say(key), "");
  timer = setTimeout(hide, SHOWN_MS);
}

export function tellProblem(error) {
  if (!(error instanceof Refused)) throw error;
  const { status, detail, hint } = error.problem;
  const own = `problem.${status}`;
  return show("problem", known(own) ? say(own) : detail, known(own) && status !== 409 ? hint ?? "" : [detail, hint].filter(Boolean).join(" – "));
}

export const hide = () => byId("said").replaceChildren();

function show(look, title, text) {
  clearTimeout(timer);
  const said = byId("said");
  said.dataset.look = look;
  said.replaceChildren(make("b", {}, title), text);
}
