/* The colour map of the report: it grows evenly in lightness, so it reads without colour vision and on paper. */
const TABLE = [
  [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37],
];
export const STOPS = TABLE.length;

/* [red, green, blue] of a share 0…1. */
export function colourOf(share) {
  const place = Math.min(Math.max(share, 0), 1) * (STOPS - 1), from = Math.min(Math.floor(place), STOPS - 2);
  return TABLE[from].map((value, i) => Math.round(value + (place - from) * (TABLE[from + 1][i] - value)));
}
