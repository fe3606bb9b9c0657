// The page: one socket in, buttons out. Whatever comes is shown as text, never as markup.
import { Picture } from './picture.js';
import { COLORS, Plot } from './plot.js';
import { showNodes, shown as shownNumber, showVerdict } from './tables.js';

const TOKEN = document.querySelector('meta[name=token]').content;
const KEPT = 6000, SHORTEST_S = 20, OLD_MS = 1000, TIRED_MS = 1000, ALIVE_MS = 3000;
const byId = (id) => document.getElementById(id);
const picture = new Picture(byId('view'));
const plots = {
  joints: new Plot(byId('plot-joints')),
  position: new Plot(byId('plot-position'), { fromZero: true }),
  rotation: new Plot(byId('plot-rotation'), { fromZero: true }),
};
let facts = {}, samples = [], have = { version: 0, sample: 0 }, socket = null, heard = 0;

// Socket.

function connect() {
  socket = new WebSocket(`ws://${location.host}/live`);
  socket.binaryType = 'blob';
  socket.onopen = () => {
    facts = {};
    samples = [];
    have = { version: 0, sample: 0 };
    say({ token: TOKEN, watch: !document.hidden, ...have });
  };
  socket.onmessage = ({ data }) => (typeof data === 'string' ? update(JSON.parse(data)) : frame(data));
  socket.onclose = ({ code }) => {
    socket = null;
    if (code === 4001) location.reload(); // the dashboard was restarted: get its new token
    else setTimeout(connect, TIRED_MS);
  };
}

function say(words) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(words));
}

async function frame(blob) {
  try {
    await picture.take(blob);
    document.body.dataset.frames = picture.frames;
  } finally {
    say({ frame: true });
  }
}

function update(news) {
  heard = performance.now();
  Object.assign(facts, news.facts);
  samples.push(...news.samples);
  if (samples.length > KEPT) samples.splice(0, samples.length - KEPT);
  have = { version: news.version, sample: news.sample };
  try {
    show(news.facts);
  } finally {
    say(have);
  }
}

// Showing.

function show(changed) {
  const names = Object.keys(changed);
  for (const name of names.filter((n) => n.startsWith('state/'))) {
    byId(`state-${name.slice(6)}`).textContent = changed[name];
  }
  if (names.some((n) => n.startsWith('node/'))) showNodes(facts);
  if ('verdict' in changed || 'progress' in changed) showVerdict(facts.verdict, target());
  if ('path' in changed || 'verdict' in changed || 'image_size' in changed
      || 'progress' in changed || 'state/visual_servo' in changed) showPath();
  showButtons();
  drawCurves();
}

function target() { // index of the pose that the servo goes to, or null
  const busy = /^(MOVING|LOOKING|HOLD)/.test(facts['state/visual_servo'] || '');
  const { pose, of, reached } = facts.progress || {};
  if (!busy || !pose) return null;
  return reached && pose < of ? pose : pose - 1; // a pose that is reached gives way to the next
}

function showPath() {
  picture.size = facts.image_size || null;
  picture.path = facts.path || [];
  const poses = (facts.verdict && facts.verdict.poses) || [];
  picture.bad = new Set(poses.flatMap((p, k) => (p.level === 'error' ? [k] : [])));
  picture.target = target();
  picture.draw();
  const { progress } = facts;
  byId('target').textContent = picture.target !== null
    ? `to pose ${picture.target + 1} of ${progress.of}${
      progress.iterations > 1 && !progress.reached ? `, move ${progress.iterations}` : ''}`
    : picture.path.length ? `a path of ${picture.path.length} poses` : 'no path';
}

function showButtons() {
  const paused = /^HOLD: paused/.test(facts['state/visual_servo'] || '');
  const pause = document.querySelector('[data-press=pause], [data-press=go_on]');
  pause.dataset.press = paused ? 'go_on' : 'pause';
  pause.textContent = paused ? 'Go on' : 'Pause';
  const latched = /^LATCHED/.test(facts['state/robix_bridge'] || '');
  document.querySelector('[data-press=reset_arm]').hidden = !latched;
}

function drawCurves() {
  const last = samples.length ? samples[samples.length - 1][0] : 0;
  const age = samples.length ? last - samples[0][0] : 0;
  const span = Math.min(Math.max(age, SHORTEST_S), facts.span_s || SHORTEST_S);
  const shown = samples.filter(([t]) => t >= last - span - 0.2);
  const times = shown.map(([t]) => t);
  const names = facts.joint_names || [];
  const joints = names.map((_, k) => shown.map(([, j]) => (j ? j[k] ?? null : null)));
  plots.joints.draw(times, joints, span);
  plots.position.draw(times, [shown.map(([, , p]) => p)], span);
  plots.rotation.draw(times, [shown.map(([, , , r]) => r)], span);
  showLegend(names, joints);
}

function showLegend(names, joints) {
  const list = byId('legend-joints');
  while (list.children.length > names.length) list.lastChild.remove();
  names.forEach((name, k) => {
    if (!list.children[k]) {
      const item = document.createElement('li');
      item.append(document.createElement('i'), document.createElement('span'));
      item.firstChild.style.background = COLORS[k % COLORS.length];
      list.append(item);
    }
    const value = joints[k][joints[k].length - 1];
    list.children[k].lastChild.textContent =
      `${name} ${shownNumber(value, 1)}`;
  });
}

function watchAges() {
  const now = performance.now();
  byId('lost').hidden = Boolean(heard) && now - heard < ALIVE_MS;
  const silent = now - picture.seen;
  byId('no-picture').hidden = Boolean(picture.frames) && silent < OLD_MS;
  byId('no-picture').textContent = picture.frames
    ? `no new picture for ${(silent / 1000).toFixed(0)} s`
    : 'waiting for pictures from snake_tracker';
}

// Buttons.

async function press(button) {
  const name = button.dataset.press, label = button.textContent;
  const answer = byId('answer');
  if (name !== 'stop') button.disabled = true; // stop can always be pressed again
  answer.className = '';
  answer.textContent = `${label} \u2026`;
  try {
    const reply = await fetch(`/press/${name}`, { method: 'POST', headers: { 'X-Token': TOKEN } });
    const { ok, message } = await reply.json();
    answer.className = ok ? 'ok' : 'error';
    answer.textContent = `${label}: ${message}`;
  } catch (error) {
    answer.className = 'error';
    answer.textContent = `${label}: the dashboard did not answer. To stop, use the arm's own switch.`;
  } finally {
    button.disabled = false;
  }
}

// A button acts when it is pressed down, not when it is let go: stop must not wait for a finger.
const stop = document.querySelector('[data-press=stop]');
stop.addEventListener('pointerdown', () => press(stop));
stop.addEventListener('click', (event) => { if (event.detail === 0) press(stop); }); // keyboard
for (const button of document.querySelectorAll('[data-press]')) {
  if (button !== stop) button.addEventListener('click', () => press(button));
}
document.addEventListener('keydown', (event) => { if (event.key === 'Escape' && !event.repeat) press(stop); });
byId('show-path').addEventListener('change', ({ target: box }) => {
  picture.showPath = box.checked;
  picture.draw();
});
document.addEventListener('visibilitychange', () => say({ watch: !document.hidden }));
window.addEventListener('resize', () => { picture.draw(); drawCurves(); });
setInterval(watchAges, 500);
connect();
