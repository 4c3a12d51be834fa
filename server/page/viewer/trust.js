// The error to expect where the viewer stands, between the places that the run has told.
const NEAR = 1e-6; // m, so that a place itself divides by something

/** Return the expected error over white at a centre {x, y, z} in m: the places' geometric mean, near ones above all. */
export function expectedError({ places, of_white: shares }, { x, y, z }) {
  let sum = 0;
  let logs = 0;
  places.forEach((place, i) => {
    const weight = (Math.hypot(place[0] - x, place[1] - y, place[2] - z) + NEAR) ** -4;
    sum += weight;
    logs += weight * Math.log(Math.max(shares[i], NEAR));
  });
  return Math.exp(logs / sum);
}

/** Return the words for it, such as "error about 2% of white"; none where the run tells nothing. */
export function errorInWords(table, centre) {
  if (!table) return '';
  const percent = 100 * expectedError(table, centre);
  return `error about ${percent < 9.95 ? percent.toFixed(1) : Math.round(percent)}% of white`;
}
