/* Section with the error map: deviation of the uncompensated machine on three planes, or its uncertainty. */
import { number, say } from "./language.js";
import { choice, facts, heading, remark } from "./parts.js";
import { planeMaps } from "./plane-map.js";
import { read } from "./requests.js";

export const ofRun = true, needsEstimate = true;
let shown = "deviation";

export async function parts({ run, again }) {
  const found = await read(`/api/page/runs/${encodeURIComponent(run)}/map`);
  const planes = found[shown];
  const chosen = (what) => {
    shown = what;
    again({ quiet: true });
  };
  return [
    heading("map.title"),
    choice("map.choose", [["deviation", "map.deviation"], ["uncertainty", "map.uncertainty"]], shown, chosen),
    facts([["map.before", um(found.before)], ["map.after", um(found.after)]]),
    ...planeMaps(planes),
    remark(shown === "deviation" ? "map.deviation_is" : "map.uncertainty_is"),
  ];
}

const um = ({ value_um, standard_uncertainty_um, limits_um }) =>
  limits_um ? say("unit.um_limits", { value: number(value_um, 1), lower: number(limits_um[0], 1), upper: number(limits_um[1], 1) }) :
  say(standard_uncertainty_um === null ? "unit.um" : "unit.um_sigma", { value: number(value_um, 1), sigma: number(standard_uncertainty_um, 1) });
