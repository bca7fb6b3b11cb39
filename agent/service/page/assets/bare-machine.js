/* The machine without a path, drawn at once while the path is being computed: travel, table, stations, reach of the probe. */
/* globals paintWorkspace, disc, ring */
const TABLE_BEYOND_MM = 200, TABLE_THICK_MM = 40;

/* Converts the response of `/api/machine` for `paintWorkspace`. */
export function machineOf({ limits_mm: limits, tool_offset_mm: offset, stations_mm: stations, standing_at: standing }) {
  const low = limits.map(([from], axis) => from + offset[axis]), high = limits.map(([, to], axis) => to + offset[axis]);
  const floor = Math.min(low[2], ...stations.map((place) => place[2])) - TABLE_BEYOND_MM;
  const beyond = (values, sign) => values.slice(0, 2).map((value) => value + sign * TABLE_BEYOND_MM);
  return { travel: { low, high }, table: { low: [...beyond(low, -1), floor - TABLE_THICK_MM], high: [...beyond(high, 1), floor] }, stations, standing };
}

export function paintMachine(context, camera, machine, colours) {
  paintWorkspace(context, camera, machine, colours);
  machine.stations.forEach((place, i) => {
    const [x, y] = camera.project(place);
    disc(context, x, y, 11, colours.paper);
    ring(context, x, y, 11, colours.station(i + 1), machine.standing === i + 1 ? 4 : 2);
    Object.assign(context, { fillStyle: colours.ink, font: "600 12px system-ui, sans-serif", textAlign: "center", textBaseline: "middle" });
    context.fillText(String(i + 1), x, y + 0.5);
  });
}
