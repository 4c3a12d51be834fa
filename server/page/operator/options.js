// The fields of a form, made from the JSON Schema of a job (GET /v1/options).
import { element } from './dom.js';
import { OPTIONS } from './words.js';

const GIVEN = ['type', 'capture', 'job', 'follow']; // filled in by the page
const FIRST = ['from', 'model', 'holdout', 'budget_s', 'board', 'method', 'ticks', 'format', 'at_s', 'name'];
const HINTS = { board: 'charuco:6x4:100:67.5:DICT_4X4_50', ticks: 'all, or 0:400:20' };
const NOTES = {
  board: 'charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY or apriltag:…; empty: from whatever the cameras see',
};
const NONE = { rig: 'the one recorded with' };

// Return the schema of a property without the null that says it may be left out.
const kindOf = (schema) => ({ ...(schema.anyOf?.find((one) => one.type !== 'null') ?? schema), default: schema.default });

function choice(id, options, chosen, empty, names = options) {
  const made = element('select', { id });
  if (empty !== undefined) made.append(element('option', { value: '' }, empty));
  made.append(...options.map((value, i) => element('option', { value }, names[i])));
  made.value = chosen ?? (empty !== undefined ? '' : options[0]);
  return made;
}

const boxes = (id, cameras, chosen) => element('div', { id, className: 'boxes', role: 'group', ariaLabel: OPTIONS.views },
  cameras.map((camera) => element('label', {}, element('input', { type: 'checkbox', value: camera, checked: chosen.includes(camera) }), camera)));

const number = (id, kind) => element('input', {
  id, type: 'number', step: kind.type === 'integer' ? 1 : 'any', min: kind.minimum ?? '', max: kind.maximum ?? '',
  value: kind.default ?? '', placeholder: kind.default == null ? 'auto' : '',
});

function inputOf(id, name, kind, cameras, given) {
  if (name === 'holdout') return choice(id, cameras, given ? kind.default : cameras[Math.floor(cameras.length / 2)], 'none');
  if (name === 'camera') return choice(id, cameras, kind.default, 'none');
  if (kind.enum) return choice(id, kind.enum, kind.default, kind.default == null && kind.optional ? NONE[name] ?? 'none' : undefined, kind.names);
  if (kind.type === 'array') return boxes(id, cameras, kind.default ?? cameras);
  if (kind.type === 'boolean') return element('input', { id, type: 'checkbox', checked: Boolean(kind.default) });
  if (kind.type === 'integer' || kind.type === 'number') return number(id, kind);
  return element('input', { id, type: 'text', maxLength: kind.maxLength ?? 200, placeholder: HINTS[name] ?? '', value: kind.default ?? '' });
}

function valueOf(input, kind, cameras) {
  if (kind.type === 'array') {
    const chosen = [...input.querySelectorAll('input:checked')].map((box) => box.value);
    return chosen.length === cameras.length ? undefined : chosen;
  }
  if (kind.type === 'boolean') return input.checked;
  if (input.value === '') return undefined;
  return kind.type === 'integer' || kind.type === 'number' ? Number(input.value) : input.value;
}

function field(name, input, required) {
  const label = OPTIONS[name] ?? name.replaceAll('_', ' ');
  if (input.role === 'group') return element('fieldset', {}, element('legend', {}, label), input);
  input.required = required;
  const note = NOTES[name] && element('span', { id: `${input.id}-note` }, NOTES[name]);
  if (note) input.setAttribute('aria-describedby', note.id);
  const check = input.type === 'checkbox' && 'check';
  return element('label', { htmlFor: input.id, className: check || (name === 'board' ? 'wide' : '') }, check ? [input, label] : [label, input], note);
}

// Return {first, more, values}: the fields to show at once, those behind "more", and a function for their values.
// They are filled with what is `given` or else with the defaults.
export function fieldsOf({ properties, required = [] }, cameras, given) {
  const names = Object.keys(properties).filter((name) => !GIVEN.includes(name));
  const filled = (name) => (given && name in given ? { default: given[name] } : {});
  const kinds = Object.fromEntries(names.map((name) => [name, { ...kindOf(properties[name]), optional: !required.includes(name), ...filled(name) }]));
  const inputs = Object.fromEntries(names.map((name) => [name, inputOf(`option-${name}`, name, kinds[name], cameras, given)]));
  const made = (name) => field(name, inputs[name], required.includes(name));
  return {
    first: FIRST.filter((name) => name in inputs).map(made),
    more: names.filter((name) => !FIRST.includes(name)).map(made),
    values: () => Object.fromEntries(names.map((name) => [name, valueOf(inputs[name], kinds[name], cameras)]).filter(([, value]) => value !== undefined)),
  };
}
