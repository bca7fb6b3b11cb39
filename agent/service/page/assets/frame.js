/* Frame around the views: name and state of the machine, choice of view and language, loss of connection. */
import { byId } from "./dom.js";
import { languageNow, languages, nameLanguage, number, onLanguage, say, speak, translate } from "./language.js";
import { on, seen } from "./store.js";
import { lookOf, restWord, verdictWord } from "./wording.js";

const VIEWS = ["operator", "engineer"];

/* `opened` is called with the name of the view that has been opened. */
export function openFrame(opened) {
  for (const view of VIEWS) byId(`tab-${view}`).addEventListener("click", () => choose(view, opened));
  document.querySelector(".views").addEventListener("keydown", ({ key }) => {
    if (!["ArrowLeft", "ArrowRight"].includes(key)) return;
    const next = VIEWS.find((view) => byId(`view-${view}`).hidden);
    choose(next, opened);
    byId(`tab-${next}`).focus();
  });
  byId("language").addEventListener("click", () => speak(other()));
  const words = () => {
    translate();
    nameLanguage(other());
    if (seen.status) showState(seen.status);
  };
  words();
  onLanguage(words);
  on("status", showState);
  on("stale", showSilence);
  const footer = document.querySelector(".controls");
  new ResizeObserver(() => document.documentElement.style.setProperty("--footer", `${footer.offsetHeight}px`)).observe(footer);
}

const other = () => languages().find((language) => language !== languageNow()) ?? languageNow();

function choose(view, opened) {
  for (const name of VIEWS) {
    byId(`view-${name}`).hidden = name !== view;
    byId(`tab-${name}`).setAttribute("aria-selected", String(name === view));
    byId(`tab-${name}`).tabIndex = name === view ? 0 : -1;
  }
  opened(view);
}

function showState(status) {
  const { machine, state, verdict } = status;
  byId("machine").textContent = machine;
  const badge = byId("state");
  badge.dataset.look = lookOf(status);
  badge.dataset.verdict = verdict ? verdict.name : "";
  badge.dataset.state = state;
  const word = verdict ? verdictWord(verdict) : restWord(status);
  badge.querySelector(".word").textContent = word;
  document.title = `${word} – ${machine}`;
}

function showSilence(stale) {
  const seconds = Math.round((Date.now() - seen.lastMessage) / 1000);
  document.body.classList.toggle("stale-data", stale);
  byId("stale").hidden = !stale;
  byId("stale").textContent = stale ? say("stale.text", { seconds: number(seconds, 0) }) : "";
}
