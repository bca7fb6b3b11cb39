/* Section with the volumetric errors over the nights: without table, with the active table, held-out balls. */
import { make } from "./dom.js";
import { say } from "./language.js";
import { heading, remark } from "./parts.js";
import { read } from "./requests.js";
import { alarmList, keyOfLines, trendFigure } from "./trend-figure.js";

export const ofRun = false;

export async function parts() {
  const { trends, alarms } = await read("/api/page/trends");
  const shown = trends.filter(({ volumetric }) => volumetric);
  if (!shown.length) return [heading("trend.title"), remark("trend.none")];
  return [heading("trend.title"), ...alarmList(alarms),
    make("div", { className: "figures" }, ...shown.map((trend) => trendFigure(trend, say(`trend.${trend.name}`)))), keyOfLines()];
}
