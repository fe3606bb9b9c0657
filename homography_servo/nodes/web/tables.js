// Verdict and nodes as tables.

const byId = (id) => document.getElementById(id);
const DEG = 180 / Math.PI;

function make(tag, text, className) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  if (className) element.className = className;
  return element;
}

export function shown(value, digits, factor = 1) {
  const number = Number.parseFloat(value);
  return Number.isFinite(number) ? (factor * number).toFixed(digits).replace('-', '\u2212') : '–';
}

function cells({ name, message, values: v }) {
  return [name.replace(/^.*pose /, ''), message, shown(v.border_px, 0), shown(v.facing_deg, 1),
    `${shown(v.joint_margin_rad, 1, DEG)} ${v.nearest_limit || ''}`,
    shown(v.joint_step_rad, 1, DEG), shown(v.conditioning, 2), shown(v.ambiguity, 2)];
}

let filled = null; // the verdict whose rows are in the table

export function showVerdict(verdict, here) {
  const sentence = byId('verdict-sentence'), table = byId('verdict-table');
  sentence.className = verdict ? verdict.level : '';
  sentence.textContent = verdict ? verdict.message : 'no path is planned yet';
  table.hidden = !verdict || !verdict.poses.length;
  if (verdict !== filled) fill(table.tBodies[0], verdict);
  filled = verdict;
  [...table.tBodies[0].rows].forEach((row, k) => row.classList.toggle('here', k === here));
}

function fill(body, verdict) {
  body.replaceChildren(...(verdict ? verdict.poses : []).map((pose) => {
    const row = make('tr', undefined, pose.level);
    row.append(...cells(pose).map((text) => make('td', text)));
    return row;
  }));
  const tried = Object.entries(verdict ? verdict.values : {})
    .filter(([key]) => key.startsWith('attempt_')).map(([, text]) => make('li', text));
  byId('attempts').hidden = tried.length < 2;
  byId('attempts').querySelector('ol').replaceChildren(...tried);
}

export function showNodes(facts) {
  const list = byId('node-list');
  const names = Object.keys(facts).filter((n) => n.startsWith('node/')).sort();
  byId('no-nodes').hidden = names.length > 0;
  for (const name of names) {
    const id = `node-${name.slice(5)}`;
    let entry = [...list.children].find((child) => child.id === id);
    if (!entry) {
      entry = nodeEntry(id, name.slice(5));
      const after = [...list.children].find((child) => child.id > id);
      list.insertBefore(entry, after || null);
    }
    fillNode(entry, facts[name]);
  }
}

function nodeEntry(id, name) {
  const entry = make('details', undefined, 'node');
  entry.id = id;
  const summary = make('summary');
  summary.append(make('span', '', 'badge'), make('b', name), make('span', ''));
  entry.append(summary, make('table'));
  return entry;
}

function fillNode(entry, { level, message, parts }) {
  const [badge, , text] = entry.querySelector('summary').children;
  badge.className = `badge ${level}`;
  badge.textContent = level === 'stale' ? 'silent' : level;
  text.textContent = level === 'ok' && parts.length ? parts[0].message : message;
  const rows = parts.flatMap((part) => [
    rowOf('th', part.name, part.message),
    ...Object.entries(part.values).map(([key, value]) => rowOf('td', key, value))]);
  entry.querySelector('table').replaceChildren(...rows);
}

function rowOf(tag, ...texts) {
  const row = make('tr');
  row.append(...texts.map((text) => make(tag, text)));
  return row;
}
