// A job's report, in a frame that runs nothing and reaches nothing: another program may have written it.
import { get, request } from './api.js';
import { artefact, download } from './media.js';

const job = new URLSearchParams(location.search).get('job') ?? '';
const place = (id) => document.getElementById(id);

async function show() {
  get(`/jobs/${encodeURIComponent(job)}`).then(({ name }) => { place('job').textContent = `Report of ${name ?? job}`; }, () => {});
  const path = artefact(encodeURIComponent(job), 'report.html');
  try {
    place('report').srcdoc = await (await request(path)).text();
    place('links').append(download('save', path, `${job}.html`, 'Save'));
  } catch (error) {
    place('notice').textContent = error.status === 401 ? 'The service asks for a token; enter it on the first page.' : error.message;
    place('notice').hidden = false;
  }
}
show();
