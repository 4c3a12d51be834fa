// The words of the page: one for each option, type of job and status, wherever it is shown.
export const OPTIONS = {
  model: 'Motion model', images: 'Images', init: 'Poses', points: 'Points', supervision: 'Spike loss', refine: 'Refine poses', pixels: 'Pixels', gains: 'Gains and lags',
  device: 'Device to train on',
  holdout: 'Camera to score on', views: 'Cameras to train on', tick_stride: 'Planes between instants', span: 'Most planes of a span',
  follow: 'Begin while it is recorded', from_tick: 'First tick of a part', to_tick: 'Tick after a part',
  budget_s: 'Time budget (s)', steps: 'Steps', seed: 'Seed', name: 'Name', priority: 'Priority (lower is sooner)',
  board: 'Board', method: 'Method', ticks: 'Planes A:B:STEP', format: 'Format', at_s: 'Instant (s)', frames: 'Frames',
  camera: 'Camera', from: 'Capture', apply: 'Use it at once', dark: 'Calibrate the pixels: the capture without light',
  rig: 'Compare with the calibration in use of', cameras: 'Cameras to look from',
};

export const JOBS = {
  reconstruct: 'Reconstruction', images: 'Images', calibrate: 'Calibration', 'check-rig': 'Rig check', verify: 'Verification',
  evaluate: 'Evaluation', render: 'Rendering', export: 'Export', preflight: 'Preflight', import: 'Import',
};

// Say a message of the service with the labels of the forms: it marks fields of a request as `field`.
export const inWords = (text) => text?.replace(/`([a-z_]+)`/g, (whole, field) => (OPTIONS[field] ? `“${OPTIONS[field]}”` : whole));

export const counted = (number, noun) => `${number} ${noun}${number === 1 ? '' : 's'}`;

const RULES = new Intl.PluralRules('en', { type: 'ordinal' });
const ENDINGS = { one: 'st', two: 'nd', few: 'rd', other: 'th' };
export const ordinal = (number) => `${number}${ENDINGS[RULES.select(number)]}`;
