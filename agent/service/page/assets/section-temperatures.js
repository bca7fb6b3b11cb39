/* Section with the temperatures of a run, and the displacement of the first ball of each position at its end. */
import { chart, level, line, points, reach } from "./chart.js";
import { make } from "./dom.js";
import { known, number, say } from "./language.js";
import { heading, remark, table } from "./parts.js";
import { read } from "./requests.js";

export const ofRun = true, needsEstimate = false;
const MOST = 1000;

export async function parts({ run }) {
  const path = `/api/runs/${encodeURIComponent(run)}`;
  const [readings, events] = await Promise.all([read(`${path}/temperatures`), read(`${path}/events?limit=${MOST}`)]);
  const drifts = events.filter(({ record }) => record.step?.endsWith("/drift") && record.drift_um);
  return [heading("temperatures.title"), ...thermometers(readings), ...drifting(drifts)];
}

function thermometers(readings) {
  if (!readings.length) return [remark("temperatures.none")];
  const sensors = [...new Set(readings.flatMap(({ celsius }) => Object.keys(celsius)))].sort();
  const series = sensors.map((sensor) => readings.filter(({ celsius }) => sensor in celsius).map(({ minutes, celsius }) => [minutes, celsius[sensor]]));
  const x = reach(series.flat().map(([minutes]) => minutes), { margin: 0.02 }), y = reach(series.flat().map(([, value]) => value));
  const draws = series.map((rows, i) => line(rows.map(([minutes]) => minutes), rows.map(([, value]) => value), `station-${i % 8}`));
  return [
    make("figure", { className: "trend single" }, chart({ title: say("temperatures.readings"), xLabel: say("temperatures.minutes"), yLabel: "°C", x, y, draws, width: 900, height: 260 })),
    table(["temperatures.sensor", "temperatures.first", "temperatures.last", "temperatures.change"].map((key) => say(key)), series.map((rows, i) => row(sensors[i], i, rows)), "compact"),
  ];
}

function row(sensor, i, rows) {
  const [first, last] = [rows[0][1], rows.at(-1)[1]];
  return [make("span", { className: `sensor station-${i % 8}`, title: sensor }, sensorWord(sensor)), ...[first, last].map((value) => say("unit.celsius", { value: number(value, 2) })), say("unit.kelvin", { value: number(last - first, 2) })];
}

function drifting(events) {
  if (!events.length) return [];
  const lengths = events.map(({ record }) => Math.hypot(...record.drift_um)), places = lengths.map((_, i) => i + 1);
  const limit = events[0].record.limit_um, x = [0.5, places.length + 0.5], y = reach([...lengths, ...(limit ? [limit] : [])], { zero: true });
  const draws = [...(limit ? [level(limit, x, "tolerance")] : []), points(places, lengths, null, "value")];
  return [make("figure", { className: "trend single" }, chart({ title: say("temperatures.drift"), xLabel: say("temperatures.position"), yLabel: "µm", x, y, draws, width: 900, height: 200 }))];
}

/* A thermometer has the name of its place; a further one at the same place has a number after it. */
function sensorWord(name) {
  const [, place, more] = /^(.*?)(-\d+)?$/.exec(name);
  const key = `sensor.${place}`;
  return `${known(key) ? say(key) : place}${more ?? ""}`;
}
