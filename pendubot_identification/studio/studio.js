/* Copyright 2026 The pendubot_identification authors. SPDX-License-Identifier: Apache-2.0 */
/* The page of the studio: `state` has all data, each step is drawn from it as HTML, and the attributes data-do and
   data-set of an element name the action of a click or a choice. */
'use strict';
const state = { step: 0, files: [], options: {}, shown: 0,
  open: {} };
let about, running = null, waiting;

/* ---- HTML: every value is escaped unless it is HTML already ---- */
class Html { constructor(text) { this.text = text; } }
const SIGNS = { '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;', "'": '&#39;' };
function plain(value) {
  if (value instanceof Html) return value.text;
  if (Array.isArray(value)) return value.map(plain).join('');
  return value == null || value === false ? '' : String(value).replace(/[&<>"']/g, (sign) => SIGNS[sign]);
}
const html = (parts, ...values) => new Html(parts.map((part, k) =>
  part + (k < values.length ? plain(values[k]) : '')).join(''));
const $ = (selector) => document.querySelector(selector);
const number = (value, digits = 4) =>
  Number(value).toPrecision(digits).replace(/e\+?(-?)(\d+)/, ' × 10^$1$2').replace('-', '−');
const button = (act, text, kind = '', disabled = false) =>
  html`<button type="button" data-do="${act}" class="${kind}" ${disabled && 'disabled'}>${text}</button>`;
const select = (set, label, value, choices) => html`<select data-set="${set}" aria-label="${label}">
  ${choices.map(([key, text]) =>
  html`<option value="${key}" ${key === String(value) && 'selected'}>${text}</option>`)}</select>`;
const heading = (title, lead) => html`<h2>${title}</h2><p class="lead">${lead}</p>`;
const busy = (text) => html`<p class="busy">${text}</p>`;
const note = (level, text, ...kids) =>
  html`<div class="level ${level}" role="${level === 'ERROR' ? 'alert' : 'note'}"><p>${text}</p>${kids}</div>`;
const more = (summary, kids) =>
  html`<details data-open="${summary}" ${state.open[summary] && 'open'}><summary>${summary}</summary>${kids}</details>`;
function actions(ready, text = 'Continue', act = `go:${state.step + 1}`, ...kids) {
  return html`<div class="actions">${state.step > 0 && button(`go:${state.step - 1}`, 'Back')}${kids}
    ${text && button(act, text, 'primary', !ready)}</div>`;
}
/* A button that applies options, or a window; `state.offers` stores them until the next drawing. */
const offer = (text, applied) => button(`apply:${state.offers.push(applied) - 1}`, text);
const spelled = (options) => Object.entries(options).map(([name, value]) =>
  `--${name.replaceAll('_', '-')}${value === 'true' ? '' : ` ${value}`}`).join(' ');
function refusal({ sentence, remedy = {}, window = '' }) {
  const [start, end] = window.split(':');
  return note('ERROR', sentence, html`<div class="row">${Object.keys(remedy).length > 0 &&
    offer(`Apply ${spelled(remedy)}`, { remedy })}
    ${window && offer(`Take the window from ${start || 0} to ${end} s`, { start, end })}</div>`);
}
function command(text) {
  const lines = text.split('\n').map((line) => html`<div>
    ${line.split(/ (?=--)/).map((word) => html`<span>${word}</span> `)}</div>`);
  return html`<div class="command"><code>${lines}</code>${button('copy', 'Copy')}</div>`;
}

/* ---- pictures ---- */
function rig(q1, q2, box, kids) {  // q1 from the horizontal, q2 from the line of link 1
  const [x, y] = [28 * Math.cos(q1), -28 * Math.sin(q1)];
  const [u, v] = [x + 24 * Math.cos(q1 + q2), y - 24 * Math.sin(q1 + q2)];
  return html`<svg class="rig" viewBox="${box}" aria-hidden="true"><path d="M-5 2 L-9 9 H9 L5 2"/>${kids}
    <path class="link" d="M0 0 L${x} ${y} L${u} ${v}"/><circle r="4"/><circle cx="${x}" cy="${y}" r="3.5"/>
    <circle class="tip" cx="${u}" cy="${v}" r="2.5"/></svg>`;
}
function angle(x, y, radius, zero, now) {  // a dashed line at zero, and an arc to the present angle
  const at = (phi, r) => `${x + r * Math.cos(phi)} ${y - r * Math.sin(phi)}`;
  return html`<path class="dash" d="M${x} ${y} L${at(zero, radius + 10)}"/>
    <path class="arc" d="M${at(zero, radius)} A${radius} ${radius} 0 0 ${now > zero ? 0 : 1} ${at(now, radius)}"/>`;
}
function spark(values) {
  if (!values) return '';
  const low = Math.min(...values), high = Math.max(...values), scale = 30 / (high - low || 1);
  const points = values.map((value, k) => `${(100 * k / values.length).toFixed(1)},${((high - value) * scale).toFixed(1)}`);
  return html`<svg class="spark" viewBox="0 0 100 30" preserveAspectRatio="none" aria-hidden="true">
    <polyline points="${points.join(' ')}"/></svg><small>${number(low, 3)} to ${number(high, 3)}</small>`;
}

/* ---- tasks: the answer to a request is JSON lines; to abort the request ends its program ---- */
const SILENT = { sentence: 'the studio does not answer; is it still running in its terminal?' };
const at = (path) => `sessions/${about.session}/${path}`;
function job(files = state.files) {
  const part = (wanted) => files.filter(({ role }) => role === wanted).map(({ role, ...window }) => window);
  return JSON.stringify({ bags: part('estimate'), validate: part('validate'), options: state.options });
}
function cancel() { running?.abort(); running = null; }
async function task(name, files, onProgress) {
  cancel();
  const control = running = new AbortController();
  let last = SILENT;
  try {
    const answer = await fetch(at(name), { method: 'POST', body: job(files), signal: control.signal });
    if (!answer.ok) throw { sentence: await answer.text() };
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let rest = '', chunk; !(chunk = await reader.read()).done;) {
      const lines = (rest + chunk.value).split('\n');
      rest = lines.pop();
      for (const each of lines) {
        last = JSON.parse(each);
        if ('progress' in last) onProgress(last);
      }
    }
  } catch (error) { throw error.name === 'AbortError' || error.sentence ? error : SILENT; }
  finally { if (running === control) running = null; }
  if (!('done' in last)) throw last.problem ?? SILENT;
  return last.done;
}
/* Runs a task, passes its answer on, and draws the step again. */
async function need(name, files, take) {
  if (running) return;
  try { take(await task(name, files)); } catch (error) { if (error.name === 'AbortError') return; take(null, error); }
  draw();
}

/* ---- options ---- */
const standard = (name) => String(about.settings[name].default);
const given = (name) => state.options[name] ?? (state.described ?? state.before)?.options[name] ?? standard(name);
/* Deletes all results that depend on a choice; the page shows the last description until the next one. */
function changed(part = 'reading') {
  cancel();
  if (part === 'reading') state.described = null;
  if (part !== 'fit') state.checks = null;
  state.result = state.refused = null;
  draw();
}
function choose(name, value) {
  if (value === '' || value === standard(name)) delete state.options[name]; else state.options[name] = value;
  changed(about.settings[name].reading ? 'reading' : 'fit');
}
function field(name) {
  const { kind, choices, help, optional } = about.settings[name], value = given(name), set = `option:${name}`;
  const label = name[0].toUpperCase() + name.slice(1).replaceAll('_', ' ');
  const type = kind === 'int' || kind === 'float' ? 'number' : 'text';
  const file = name === 'start' && html`<input type="file" id="start" accept=".yaml" hidden>
    ${button('pick:start', value || 'Choose a result file')}`;
  const control = file || (choices.length ? select(set, label, value, choices.map((each) => [each, each]))
    : html`<input type="${type}" step="any" aria-label="${label}" data-set="${set}"
      value="${optional && value === standard(name) ? '' : value}">`);
  return html`<label class="field">${kind === 'bool' ? html`<span class="row">
    <input type="checkbox" data-set="${set}" ${value === 'true' && 'checked'}>${label}</span>`
    : html`<span>${label}</span>${control}`}<small>${help}</small></label>`;
}
const choices = (name, legend, list) => html`<fieldset class="choices"><legend>${legend}</legend>
  ${list.map(([value, text, help, picture]) =>
  html`<label class="choice"><input type="radio" name="${name}" value="${value}" data-set="option:${name}"
    ${(given(name) || list[0][0]) === value && 'checked'}>${picture}<span>${text}<small>
      ${help}</small></span></label>`)}</fieldset>`;

/* ---- 1: recordings ---- */
function add(name) {
  if (state.files.every((file) => file.name !== name)) state.files.push({ name, role: 'estimate', start: '', end: '' });
}
/* Sends files, and calls `take` with the name of each. */
async function receive(entries, take = add, part = 'reading') {
  state.problem = null;
  for (const { file, name } of entries) {
    const path = name.split('/').map(encodeURIComponent).join('/');
    const answer = await fetch(at(`files/${path}`), { method: 'PUT', body: file }).catch(() => null);
    if (answer?.ok) take((await answer.json()).name);
    else state.problem = answer ? { sentence: await answer.text() } : SILENT;
  }
  changed(part);
}
/* Returns the files of a dropped entry and of its folders. */
async function unfold(entry) {
  if (entry instanceof File) return [{ file: entry, name: entry.name }];
  const name = entry.fullPath.slice(1), all = [];
  if (entry.isFile) return [{ file: await new Promise((...then) => entry.file(...then)), name }];
  const reader = entry.createReader(), list = () => new Promise((...then) => reader.readEntries(...then));
  for (let some; (some = await list()).length;) all.push(...some);
  return (await Promise.all(all.map(unfold))).flat();
}
async function dropped(items) {
  const entries = [...items].map((item) => item.webkitGetAsEntry() ?? item.getAsFile()).filter(Boolean);
  await receive((await Promise.all(entries.map(unfold))).flat());
}
const use = (name) => { state.options.start = name; };
function recordings() {
  const window = (file, k, key) => html`<input type="number" min="0" step="any" value="${file[key]}"
    placeholder="${key}" aria-label="${key} of ${file.name} in seconds" data-set="${key}:${k}">`;
  const list = state.files.map((file, k) => html`<li><strong>${file.name}</strong>
    ${select(`role:${k}`, `role of ${file.name}`, file.role,
      [['estimate', 'training'], ['validate', 'validation']])}
    <span class="row">${window(file, k, 'start')} – ${window(file, k, 'end')} <small>s</small></span>
      ${button(`remove:${k}`, 'Remove', 'plain')}</li>`);
  const lead = 'Motion of both joints and the torque of the motor. Files stay on this computer.';
  return html`${heading('What was recorded?', lead)}
    ${state.problem && refusal(state.problem)}
    <div class="drop">${rig(-2.2, 1.1, '-46 -8 60 62')}<strong>Drop recordings here</strong>
      <small>A bag (its folder or .mcap), or .csv, .mat, .xlsx, .parquet, .npz</small>
      <input type="file" id="files" multiple hidden><input type="file" id="folder" webkitdirectory hidden>
      <div class="row">${button('pick:files', 'Choose files')}${button('pick:folder', 'Choose a bag’s folder')}
        ${button('sample', 'Try the sample recording', 'plain')}</div></div>
    <ul class="files">${list}</ul>
    ${list.length > 0 && html`<p><small>Without a window, the first half of one recording is for training and the second for
      validation; several recordings are all for training.</small></p>`}${actions(estimating())}`;
}

/* ---- 2: columns ---- */
const NEEDED = { t: 'Time', q1: 'Shoulder angle', q2: 'Elbow angle', tau1: 'Shoulder torque' };
const ROWS = { ...NEEDED, tau2: 'Elbow torque', dq1: 'Shoulder speed', dq2: 'Elbow speed' };
const UNITS = { us: 'µs', Nm: 'N m', mNm: 'mN m', Ncm: 'N cm', kgfcm: 'kgf cm', ozfin: 'ozf in' };
const negated = () => given('negate').split(',').filter(Boolean);
const named = () => Object.fromEntries((state.options.columns ?? '').split(/,(?=\w+=)/).filter(Boolean)
  .map((pair) => pair.split(/=(.*)/)));
function unit(name) {
  if (name[0] === 'd') return given('degrees') === 'true' ? 'deg/s' : 'rad/s';
  if (name[0] === 'q') return select('option:degrees', `unit of ${name}`, given('degrees').toLowerCase(),
    [['false', 'rad'], ['true', 'degrees']]);
  const option = name === 't' ? 'time_unit' : 'torque_unit';
  return select(`option:${option}`, `unit of ${name}`, given(option),
    about.settings[option].choices.map((each) => [each, UNITS[each] ?? each]));
}
function row(found, name) {
  const table = found.columns.length > 0, column = found.taken[name] ?? '';
  const columns = table && html`<td class="wide ${name in NEEDED && !column && 'missing'}">
    ${select(`column:${name}`, `column of ${name}`, column,
    ['', ...found.columns].map((each) => [each, each || '–']))}</td>`;
  const sign = /^(q|tau)/.test(name) && select(`sign:${name}`, `sign of ${name}`, negated().includes(name),
    [['false', '+'], ['true', '− reversed']]);
  return html`<tr><th scope="row">${ROWS[name]}<small>${name}</small></th>${columns}<td>${unit(name)}</td>
    <td>${sign}</td><td>${spark(found.preview?.[name])}</td></tr>`;
}
function bag(found) {
  const joints = found.joints.map((name) => [name, name]);
  return html`<h3>Topic and joints</h3><div class="row">
    ${select('option:topic', 'topic', given('topic'), found.topics.map((each) => [each, each]))}
    ${['shoulder', 'elbow'].map((joint, k) => html`<label class="row">${joint}
      ${select(`joint:${k}`, joint, given('joints').split(',')[k], joints)}</label>`)}</div>`;
}
const BOX = '-16 -8 62 60', DOWN = -Math.PI / 2;
const ZERO = [['horizontal', 'Horizontal', 'at rest it is −90°', rig(-0.9, -0.4, BOX, angle(0, 0, 19, 0, -0.9))],
  ['hanging', 'Hanging', 'at rest it is 0°', rig(-0.9, -0.4, BOX, angle(0, 0, 19, DOWN, -0.9))]];
const ELBOW = [['relative', 'Relative', 'from the line of link 1',
  rig(-1.2, 1, BOX, angle(10.1, 26.1, 14, -1.2, -0.2))],
  ['absolute', 'Absolute', 'from the zero of the shoulder', rig(-1.2, 1, BOX, angle(10.1, 26.1, 14, DOWN, -0.2))]];
function columns() {
  const found = state.described, shown = found ?? state.before;
  if (!found) need('describe', [{ ...state.files[state.shown], role: 'estimate' }], (value, problem) => {
    state.described = state.before = value ?? { columns: [], taken: {}, topics: [], joints: [], options: {}, problem };
  });
  const table = shown?.columns.length > 0, names = table ? Object.keys(ROWS) : ['q1', 'q2', 'tau1'];
  const rows = names.filter((name) => name in NEEDED || shown?.taken[name] || state.all).map((name) => shown &&
    row(shown, name));
  const head = ['Quantity', ...(table ? ['Column'] : []), 'Unit', 'Sign', 'Converted to rad and N m'];
  const rest = ['torque_constant', 'gear', 'unwrap', 'swap', 'offset', 'skip_missing',
    ...(shown?.topics.length ? [] : ['decimal', 'skip_rows', 'sheet', 'encoding'])];
  const lead = 'Check the column, unit and sign of each quantity. They are the same for all recordings.';
  return html`${heading('How is it written?', lead)}
    ${state.files.length > 1 && html`<div class="tabs">${state.files.map((file, k) =>
      html`<button type="button" data-do="show:${k}" aria-pressed="${k === state.shown}">
        ${file.name}</button>`)}</div>`}
    ${found ? '' : busy('reading')}${found?.problem && refusal(found.problem)}
    ${found?.taken_as && note('OK', html`Taken from the file itself: <code>${found.taken_as}</code>`)}
    ${shown?.topics.length > 0 && bag(shown)}
    ${(table || shown?.topics.length > 0) && html`<table class="columns"><thead><tr>
      ${head.map((text) => html`<th scope="col">${text}</th>`)}</tr></thead>
      <tbody>${rows}</tbody></table>`}${table && !state.all &&
        button('all', 'Elbow torque and speeds were recorded, too', 'plain')}
    ${choices('zero', 'Where is the shoulder angle zero?', ZERO)}${choices('elbow', 'What is the elbow angle?', ELBOW)}
    ${more('Motor current, wrapped angles, offsets, exchanged joints, text and sheets',
      html`<div class="fields">${rest.map(field)}</div>`)}
    ${actions(found && !found.problem)}`;
}

/* ---- 3: checks ---- */
const CHECKS = { reading: 'Samples', stamps: 'Time stamps', gaps: 'Gaps', limits: 'Limits', conventions: 'Conventions',
  excitation: 'Excitation' };
const MARKS = { OK: ['✓', 'good'], WARN: ['!', 'warning'], ERROR: ['✕', 'error'] };
const passed = () => Boolean(state.checks) && !state.checks.some(({ level, check }) => level === 'ERROR' &&
  check !== 'conventions');
function checks() {
  if (!state.checks) need('check', state.files, (value, error) => {
    state.checks = value ?? [{ check: 'reading', level: 'ERROR', remedy: {}, ...error }];
  });
  const list = (state.checks ?? []).map(({ check, level, sentence, remedy }) => html`<li><span class="dot ${level}"
    role="img" aria-label="${MARKS[level][1]}">${MARKS[level][0]}</span><strong>${CHECKS[check]}</strong><div>
    <p>${sentence}</p>${Object.keys(remedy).length > 0 && offer(`Apply ${spelled(remedy)}`,
      { remedy, whole: check === 'conventions' })}</div></li>`);
  return html`${heading('Is it good enough?', 'All checks before a fit.')}
    ${state.checks ? html`<ul class="checks">${list}</ul>`
      : busy('checking stamps, gaps, limits, conventions and excitation')}
    ${actions(passed(), 'Continue', 'go:3', button('go:1', 'Correct the columns'))}`;
}

/* ---- 4: method ---- */
const CRITERIA = [['likelihood', 'Likelihood', 'the most accurate; seconds to a minute'],
  ['weak', 'Weak form', 'nearly as accurate; at once'],
  ['energy', 'Energy', 'the paper’s, by differential evolution']];
const MODELS = [['auto', 'Auto', 'the smallest whose residual is at the quantization level, or else the largest'],
  ['viscous', 'Viscous', 'the paper’s seven parameters'],
  ['coulomb', 'Coulomb', 'and dry friction'], ['rotor', 'Rotor', 'and a rotor at the elbow'],
  ['geared', 'Geared', 'and friction of gears']];
function method() {
  const rest = ['hold', 'delay', 'link_length', 'link_mass', 'sliding', 'optimizer', 'bounds', 'seed', 'spread', 'start',
    'apply_remedies'];
  return html`${heading('How is it fitted?', 'The defaults suit nearly every rig.')}${state.problem && refusal(state.problem)}
    ${choices('criterion', 'Criterion', CRITERIA)}
    ${choices('model', 'Model', MODELS)}${more('Hold, delay, length of link 1, bounds, seed, start',
      html`<div class="fields">${rest.map(field)}</div>`)}${actions(passed())}`;
}

/* ---- 5: fit ---- */
async function fit() {
  const stages = [], began = performance.now(), show = (event) => {
    const { progress: before } = state.fitting;
    if (before && before !== event.progress && !stages.includes(before)) stages.push(before);
    Object.assign(state.fitting, event, { seconds: Math.round((performance.now() - began) / 1000) });
    if ($('#fitting')) $('#fitting').innerHTML = progress().text;
  };
  Object.assign(state, { result: null, refused: null, fitting: { stages } });
  const work = task('identify', state.files, show);
  draw();
  try { state.result = await work; } catch (error) { state.refused = error; }
  state.fitting = null;
  if (state.result && state.step === 4) go(5); else draw();
}
function progress() {
  const { progress: now, done, of, best, seconds, stages } = state.fitting;
  return html`<div class="row"><strong class="busy">${now ?? 'starting'}</strong>
    <span class="note">${seconds ?? 0} s</span>${best != null && html`<span class="note">J = ${number(best, 5)}</span>`}</div>
    <progress aria-label="progress of this stage" max="${of || 1}" ${of > 0 && html`value="${done}"`}></progress>
    <ul class="stages">${stages.slice(-6).map((stage) => html`<li>${stage}</li>`)}</ul>`;
}
function fitting() {
  if (state.fitting) return html`${heading('Fitting', 'This page shows the result as soon as it is ready.')}
    <div class="card" id="fitting">${progress()}</div><div class="actions">${button('stop', 'Stop')}</div>`;
  return html`${heading('Ready', 'The fit runs in a separate program. It can be stopped at any time.')}
    ${state.refused && (state.refused.sentence ? refusal(state.refused) : note('WARN', 'Stopped. Nothing was kept.'))}
    ${actions(passed(), state.result ? 'Fit again' : 'Start', 'start')}`;
}

/* ---- 6: result ---- */
const FILES = { 'report.html': 'the page', 'result.yaml': 'every number', 'pendubot.xml': 'MuJoCo',
  'pendubot.urdf': 'RViz, Gazebo, Drake', 'pendubot.yaml': 'a ROS node', 'pendubot.m': 'MATLAB', 'pendubot.h': 'C',
  'pendubot.py': 'Python' };
const SAID = { WARN: 'Use them with care: the page gives the reasons.', ERROR: 'Do not use them: the page gives the reasons.' };
function result() {
  const { level, command: shell, files, missing } = state.result, page = at('output/report.html');
  const links = Object.keys(FILES).filter((name) => files.includes(name)).map((name) =>
    html`<a class="button" href="${at(`output/${name}`)}" download="${name}">${name}<small>${FILES[name]}</small></a>`);
  return html`<h2>The parameters of the rig</h2>${SAID[level] && note(level, SAID[level])}
    <iframe src="${page}" title="page of the result" allow="clipboard-write"
      sandbox="allow-scripts allow-downloads allow-modals"></iframe>
    <p><a href="${page}" target="_blank" rel="noopener">Open the page in its own tab</a></p>
    <h3>Files</h3><div class="take">${links}</div>
    ${Object.entries(missing).map(([name, sentence]) => html`<p><small>${name}: ${sentence}</small></p>`)}
    <h3>The same in a terminal</h3>
    ${command(`${shell} --report report\npendubot export report/result.yaml --output pendubot.urdf`)}
    ${actions(true, 'Another recording', 'again')}`;
}

/* ---- the frame ---- */
const estimating = () => state.files.some((file) => file.role === 'estimate');
/* Each step: its name, the function that draws it, and whether it is available. */
const STEPS = [['Recordings', recordings, () => true], ['Columns', columns, estimating],
  ['Checks', checks, () => state.checks || (state.described && !state.described.problem)],
  ['Method', method, passed], ['Fit', fitting, passed], ['Result', result, () => state.result]];
function go(k) { if (!state.fitting) cancel(); state.step = k; draw(); scrollTo(0, 0);
  $('#step').focus({ preventScroll: true }); }
function draw() {
  clearTimeout(waiting);
  // A pressed element must still exist when it is released.
  if ($(':is(button, label, select, summary):active')) { waiting = setTimeout(draw, 50); return; }
  const { set, do: act } = document.activeElement?.dataset ?? {};
  state.offers = [];
  $('#rail').innerHTML = STEPS.map(([name,, ready], k) => {
    const done = k < state.step && STEPS[k + 1][2]();
    return html`<li class="${done && 'done'}"><button type="button" data-do="go:${k}" ${!ready() && 'disabled'}
      aria-label="step ${k + 1}: ${name}" ${k === state.step && html`aria-current="step"`}><b>${done ? '✓' : k + 1}</b>
      <span>${name}</span></button></li>`.text;
  }).join('');
  $('#step').innerHTML = STEPS[state.step][1]().text;
  if (set || act) document.querySelector(set ? `[data-set="${set}"]`
    : `[data-do="${act}"]`)?.focus({ preventScroll: true });
}
function apply({ remedy, whole, ...window }) {
  const replaced = whole ? Object.keys(state.options).filter((name) => about.settings[name].reading) : [];
  for (const name of replaced) delete state.options[name];
  Object.assign(state.options, remedy);
  if (!remedy) Object.assign(state.files[state.shown], window);
  changed();
}
const ACTS = { go: (k) => go(Number(k)), start: fit, stop: cancel, again: () => location.reload(),
  pick: (id) => $(`#${id}`).click(),
  sample: () => { add('paper_experiment'); changed(); },
  remove: (k) => { state.files.splice(k, 1); state.shown = 0; changed(); },
  show: (k) => { state.shown = Number(k); state.described = null; cancel(); draw(); },
  all: () => { state.all = true; draw(); }, apply: (k) => apply(state.offers[k]),
  copy: (_, own) => navigator.clipboard.writeText(own.previousElementSibling.innerText)
    .then(() => { own.textContent = 'Copied'; }) };
const edit = (key, part) => (k, value) => { state.files[k][key] = value; changed(part); };
const SETS = { option: choose,
  joint: (k, value) => {
    const both = given('joints').split(',');
    if (both[1 - k] === value) both[1 - k] = both[k];
    both[k] = value;
    choose('joints', both.join(','));
  },
  role: edit('role', 'roles'), start: edit('start'), end: edit('end'),
  column: (name, value) => choose('columns', Object.entries({ ...named(), [name]: value }).filter(([, each]) =>
    each).map((pair) => pair.join('=')).join(',')),
  sign: (name, value) => choose('negate', Object.keys(ROWS).filter((each) =>
    (each === name ? value === 'true' : negated().includes(each))).join(',')) };
function listen() {
  addEventListener('click', ({ target }) => {
    const found = target.closest('[data-do]:enabled'), [act, value] = found?.dataset.do.split(':') ?? [];
    if (act) ACTS[act](value, found);
  });
  addEventListener('change', ({ target }) => {
    const [kind, name] = target.dataset.set?.split(':') ?? [];
    if (kind) SETS[kind](name, target.type === 'checkbox' ? String(target.checked) : target.value.trim());
    else if (target.files) receive([...target.files].map((file) =>
      ({ file, name: file.webkitRelativePath || file.name })), ...(target.id === 'start' ? [use, 'fit'] : []));
  });
  addEventListener('toggle', ({ target }) => {
    if (target.dataset?.open) state.open[target.dataset.open] = target.open;
  }, true);
  for (const name of ['dragover', 'dragleave', 'drop']) addEventListener(name, (event) => {
    event.preventDefault();
    $('.drop')?.classList.toggle('over', name === 'dragover');
    if (name === 'drop' && state.step === 0) dropped(event.dataTransfer.items);
  });
  addEventListener('pagehide', () => navigator.sendBeacon(at('end')));
  addEventListener('pageshow', (event) => { if (event.persisted) location.reload(); });
}
async function start() {
  const answer = await fetch('sessions', { method: 'POST' });
  if (!answer.ok) { $('#step').innerHTML = note('ERROR', await answer.text()).text; return; }
  about = await answer.json();
  about.given.forEach(add);
  listen();
  draw();
}
start();
