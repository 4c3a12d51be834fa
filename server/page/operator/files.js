// The files that a person drops or chooses, and the cameras that their names tell.
const NATURAL = new Intl.Collator('en', { numeric: true, sensitivity: 'base' });

async function within(entry) {
  if (entry.isFile) return [await new Promise((resolve, reject) => { entry.file(resolve, reject); })];
  const reader = entry.createReader(), found = [];
  for (;;) {
    const some = await new Promise((resolve, reject) => { reader.readEntries(resolve, reject); }); // a hundred at a time
    if (!some.length) return found;
    for (const one of some) found.push(...await within(one));
  }
}

// All files of a drop, those in its folders too.
export async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.() ?? item.getAsFile());
  const found = await Promise.all(entries.map((one) => (one instanceof File ? [one] : one ? within(one) : [])));
  return found.flat();
}

// Tell recordings from the file of the cameras and from what is neither.
export function sorted(files) {
  const named = (pattern) => files.filter((file) => pattern.test(file.name)).sort((a, b) => NATURAL.compare(a.name, b.name));
  const dats = named(/\.dat$/i), [cameras] = named(/\.(toml|json)$/i).filter((file) => file.name !== 'recording.json');
  return { dats, cameras, others: files.filter((file) => file !== cameras && !dats.includes(file)) };
}

function cameraIn(name, cameras) {
  const [, row, column] = /cam[_-]?(\d)[_-]?(\d)(?!\d)/i.exec(name) ?? [];
  const told = cameras.find((id) => name.toLowerCase().startsWith(`${id.toLowerCase()}.`)) ?? `cam${row}${column}`;
  return cameras.includes(told) ? told : null;
}

// The camera of each name: as it says or, of those that do not, in their order; '' where there are too many.
export function guessed(names, cameras) {
  const found = names.map((name) => cameraIn(name, cameras));
  const once = found.map((id, i) => (found.indexOf(id) === i ? id : null));
  const left = cameras.filter((id) => !once.includes(id));
  return once.map((id) => id ?? left.shift() ?? '');
}

// Names of a grid of so many cameras, row by row.
export function grid(count) {
  const columns = Math.ceil(Math.sqrt(count));
  return Array.from({ length: count }, (_, i) => `cam${Math.floor(i / columns)}${i % columns}`);
}
