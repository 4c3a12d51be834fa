// A job's report, in a frame that runs nothing and reaches nothing: another program may have written it.
import { request } from './api.js';
import { byId } from './dom.js';
import { artefact, download } from './media.js';
import { headingOf } from './naming.js';

const job = new URLSearchParams(location.search).get('job') ?? '';

async function show() {
  headingOf(job).then((name) => { document.title = byId('job').textContent = `Report of ${name}`; });
  const path = artefact(encodeURIComponent(job), 'report.html');
  try {
    byId('report').srcdoc = await (await request(path)).text();
    byId('links').append(download('save', path, `${job}.html`, 'Save'));
  } catch (error) {
    byId('notice').textContent = error.status === 401 ? 'The service asks for a token; enter it on the first page.' : error.message;
    byId('notice').hidden = false;
  }
}
show();
