/* What the live view shows of a run: the position being measured, the place on its path, and the state of each ball. */
import { number, say } from "./language.js";
import { seen } from "./store.js";
import { placeOf, wasRejected } from "./wording.js";

/* globals distance */

/* Visit that the step belongs to; the first one if nothing is being measured. */
export function visitOf(plan, step) {
  const at = placeOf(step);
  if (!at) return 0;
  const key = `station-${at.station}/az${at.azimuth}-el${at.elevation}`;
  const own = plan.visits.findIndex((visit) => visit.phase === at.phase && visit.placing.key === key);
  return Math.max(own, 0);
}

/* Waypoint of the visit that the tip is nearest to, among those of the ball of the step, if it has one. A pattern of
   touches returns to its points, so the search goes on from the waypoint `former`. */
export function progressOf(plan, visit, step, tip, former) {
  const { first, end } = plan.visits[visit], ball = placeOf(step)?.ball ?? -1;
  let best = first, least = Infinity;
  for (let i = first; i < end; i++) {
    if (ball >= 0 && plan.path.ballAt[i] !== ball) continue;
    const away = distance(plan.path.tips[i], tip) + (i < former ? 1e-3 : 0);
    if (away < least - 1e-6) [best, least] = [i, away];
  }
  return best;
}

const keyOf = (station, azimuth, elevation, ball) => `${station}/${Number(azimuth)}/${Number(elevation)}/${ball}`;

/* Place of the step in the phase: one ball in one position. Balls of another phase are other measurements. */
function ballOf(step) {
  const at = placeOf(step);
  return at && at.ball !== null ? { phase: at.phase, key: keyOf(at.station, at.azimuth, at.elevation, at.ball) } : null;
}

/* Returns a function that gives the state of a ball in a position: "next", "measured", "rejected", "lost", "unreached", or ""
   if its turn has not come. A ball that was found later is no longer lost. Once nothing is being measured, all phases of the
   run count. */
export function ballStates(phase, step) {
  const now = placeOf(step) ? phase : null;
  const ofPhase = (steps) => steps.map(ballOf).filter((found) => found && (now === null || found.phase === now)).map(({ key }) => key);
  const measured = new Set(ofPhase(seen.balls.map((ball) => ball.key)));
  const rejected = new Set(ofPhase(seen.lost.filter(wasRejected).map(({ key }) => key)));
  const lost = new Set(ofPhase(seen.lost.map(({ key }) => key)));
  const [next] = now === null ? [] : ofPhase([step]);
  return (placing, ball) => {
    const key = keyOf(placing.station, placing.az, placing.el, ball.number);
    if (ball.whyNot) return "unreached";
    if (measured.has(key)) return "measured";
    if (key === next) return "next";
    return rejected.has(key) ? "rejected" : lost.has(key) ? "lost" : "";
  };
}

/* Axis positions in words, or an empty text if they are not known. */
export const axesText = (axes) => (axes ? say("scene.axes", Object.fromEntries(["x", "y", "z"].map((name, i) => [name, number(axes[i], 1)]))) : "");

/* The same in words: for those who do not see the picture. */
export function sceneText(plan, visit, stateOf, axes) {
  const { placing } = plan.visits[visit], states = placing.balls.map((ball) => stateOf(placing, ball));
  const count = (...kinds) => states.filter((state) => kinds.includes(state)).length;
  const next = placing.balls.find((_, i) => states[i] === "next");
  const angle = (value) => number(value, 0);
  return [
    say("scene.text.position", { number: visit + 1, count: plan.visits.length, station: placing.station, azimuth: angle(placing.az), elevation: angle(placing.el) }),
    say("scene.text.balls", { measured: count("measured"), reachable: placing.reachable, lost: count("lost", "rejected"), unreached: count("unreached") }),
    next ? say("scene.text.next", { ball: next.number }) : "",
    axes ? axesText(axes) : say("scene.text.no_axes"),
  ].filter(Boolean).join(" ");
}
