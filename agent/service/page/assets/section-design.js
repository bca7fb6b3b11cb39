/* Section with the position set of the settings: expected error before and after it, and its increase without each position. */
import { make } from "./dom.js";
import { instant, number, say } from "./language.js";
import { facts, heading, remark, table } from "./parts.js";
import { read } from "./requests.js";

export const ofRun = false;

export async function parts() {
  const worth = await read("/api/page/worth");
  const largest = Math.max(...worth.positions.map(({ lost_um }) => lost_um), 1e-9);
  const um = (value, digits = 2) => say("unit.um", { value: number(value, digits) });
  return [
    heading("design.title"),
    facts([["design.set", worth.position_set], ["design.positions", number(worth.positions.length, 0)], ["design.balls", number(worth.balls, 0)],
      ["design.minutes", say("unit.minutes", { minutes: number(worth.minutes, 1) })],
      ["design.latencies", worth.latencies_from ? say("design.latencies_run", { started: startOf(worth.latencies_from) }) : say("design.latencies_stated")],
      ["design.before", um(worth.before_um)], ["design.after", um(worth.after_um)],
      ["design.percent", say("unit.percent", { value: number(worth.percent, 1) })]]),
    remark("design.is"),
    table(["place.number", "place.azimuth", "place.elevation", "design.balls", "design.lost"].map((key) => say(key)),
      worth.positions.map((position) => [...place(position), number(position.balls, 0), weight(position.lost_um, largest)])),
    ...listed("design.held_out", worth.held_out),
    ...listed("design.out_of_reach", worth.out_of_reach),
  ];
}

/* The time at which a run began, from its name such as 20261127T010000Z-aaaa. */
const startOf = (run) => instant(run.replace(/^(....)(..)(..)T(..)(..)(..)Z.*$/, "$1-$2-$3T$4:$5:$6Z"));

const place = ({ station, azimuth_deg, elevation_deg }) => [number(station, 0), `${number(azimuth_deg, 1)}°`, `${number(elevation_deg, 1)}°`];

/* Bar proportional to the increase of the error without the position. */
function weight(lost, largest) {
  const bar = make("span", { className: "weight", ariaHidden: "true" });
  bar.style.width = `${Math.max(2, (120 * lost) / largest)}px`;
  return make("span", { className: "weighed" }, say("unit.um", { value: number(lost, 3) }), bar);
}

function listed(key, positions) {
  if (!positions.length) return [];
  return [make("h3", {}, say(key)), table(["place.number", "place.azimuth", "place.elevation"].map((name) => say(name)), positions.map(place), "compact")];
}
