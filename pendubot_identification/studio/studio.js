/* Copyright 2026 The pendubot_identification authors. SPDX-License-Identifier: Apache-2.0 */
/* The page of the studio. `state` has all that is known; a step draws itself from it. */
'use strict';
const STEPS = ['Recordings', 'Columns', 'Checks', 'Method', 'Fit', 'Result'];
const state = { step: 0, files: [], options: {}, topic: '', joints: '', shown: 0, described: null, checks: null,
  result: null,
  command: '', error: null };
let about, running = null, problem = null;

/* ---- elements ---- */
const $ = (selector) => document.querySelector(selector);
function element(made, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (name.startsWith('on')) made.addEventListener(name.slice(2), value);
    else if (name in made && typeof value === 'boolean') made[name] = value;
    else if (value !== false && value != null) made.setAttribute(name, value);
  }
  made.append(...children.flat(4).filter((child) => child != null && child !== false && child !== ''));
  return made;
}
const h = (tag, attributes, ...children) => element(document.createElement(tag), attributes, children);
const fill = (selector, ...children) => { $(selector).replaceChildren(); element($(selector), {}, children); };
const s = (tag, attributes, ...children) => element(document.createElementNS('http://www.w3.org/2000/svg', tag),
  attributes, children);
const button = (text, onclick, attributes) => h('button', { type: 'button', onclick, ...attributes }, text);
const select = (label, value, choices, onchange) => {
  const options = choices.map(([key, text]) => h('option', { value: key, selected: key === value }, text));
  return h('select', { 'aria-label': label, onchange: (event) => onchange(event.target.value) }, options);
};
const number = (value, digits = 4) => Number(value).toPrecision(digits).replace(/e\+?(-?)(\d+)/,
  ' × 10^$1$2').replace('-', '−');

/* ---- the rig: a picture of angles q1 from the horizontal and q2 relative to link 1 ---- */
function rig(q1, q2, box = '-60 -60 120 120', ...more) {
  const [x, y] = [28 * Math.cos(q1), -28 * Math.sin(q1)];
  const [u, v] = [x + 24 * Math.cos(q1 + q2), y - 24 * Math.sin(q1 + q2)];
  return s('svg', { class: 'rig', viewBox: box, 'aria-hidden': 'true' },
    s('path', { class: 'base', d: 'M-5 2 L-9 9 H9 L5 2' }), more,
    s('path', { class: 'link', d: `M0 0 L${x} ${y} L${u} ${v}` }), s('circle', { r: 4 }), s('circle', { cx: x, cy: y,
      r: 3.5 }),
    s('circle', { class: 'tip', cx: u, cy: v, r: 2.5 }));
}
/* An angle about (x, y): a dashed line where it is zero, and an arc to where it is now. */
function angle(x, y, radius, zero, now, dash = radius + 12) {
  const at = (phi, r) => `${x + r * Math.cos(phi)} ${y - r * Math.sin(phi)}`;
  return [s('path', { class: 'dash', d: `M${x} ${y} L${at(zero, dash)}` }),
    s('path', { class: 'arc',
      d: `M${at(zero, radius)} A${radius} ${radius} 0 0 ${now > zero ? 0 : 1} ${at(now, radius)}` })];
}

/* ---- tasks: a request is answered by JSON lines; to abort it ends its program ---- */
async function follow(url, body, signal, onEvent) {
  let answer, ended = false;
  try {
    answer = await fetch(url, { method: body ? 'POST' : 'GET', body: body && JSON.stringify(body), signal });
    if (!answer.ok) throw { sentence: await answer.text() };
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let rest = ''; ;) {
      const { value, done } = await reader.read();
      if (done) break;
      const lines = (rest + value).split('\n');
      rest = lines.pop();
      for (const line of lines) ended = onEvent(JSON.parse(line)) || ended;
    }
  } catch (error) {
    if (error.name === 'AbortError' || error.sentence) throw error;
    throw { sentence: 'the studio does not answer; is it still running in its terminal?' };
  }
}
async function task(name, job, onProgress = () => {}) {
  cancel();
  const own = running = new AbortController();
  let found, failed;
  try {
    await follow(`sessions/${about.session}/${name}`, job, own.signal, (event) => {
      if ('done' in event && !('progress' in event)) found = event.done;
      else if (event.problem) failed = event.problem;
      else onProgress(event);
    });
  } finally { if (running === own) running = null; }
  if (failed) throw failed;
  return found;
}
function job(files = state.files) {
  const part = (role) => files.filter((file) => file.role === role).map(({ name, start, end }) => ({ name, start,
    end }));
  return { bags: part('estimate'), validate: part('validate'), options: state.options, topic: state.topic,
    joints: state.joints };
}

/* ---- options ---- */
const parsed = (text) => Object.fromEntries((text ?? '').split(',').filter(Boolean).map((pair) => pair.split(/=(.*)/).slice(0, 2)));
const joined = (pairs) => Object.entries(pairs).filter(([, value]) => value).map(([key,
  value]) => `${key}=${value}`).join(',');
const given = (name) => state.options[name] ?? (state.described ?? state.stale)?.options[name] ?? String(about.settings[name].default);
function choose(name, value) {
  if (value === '' || value === String(about.settings[name].default)) delete state.options[name];
    else state.options[name] = String(value);
  changed(CONVERSION.includes(name) ? 'reading' : 'fit');
}
/* Forgets what depends on a choice; what was read is drawn until it is read again. */
function changed(what = 'reading') {
  cancel();
  if (what === 'reading') state.described = null;
  if (what !== 'fit') state.checks = null;
  state.result = null;
  draw();
}
function cancel() { running?.abort(); running = null; }
function remedy(options, whole) {
  if (whole) for (const name of Object.keys(state.options)) if (CONVERSION.includes(name)) delete state.options[name];
  Object.assign(state.options, options);
  changed();
}
const CONVERSION = ['columns', 'skip_rows', 'sheet', 'encoding', 'decimal', 'time_unit', 'skip_missing', 'unwrap',
  'degrees', 'torque_unit',
  'swap', 'torque_constant', 'gear', 'negate', 'elbow', 'zero', 'offset'];
const asOptions = (options) => Object.entries(options).map(([name,
  value]) => `--${name.replaceAll('_', '-')}${value === 'true' ? '' : ` ${value}`}`).join(' ');
function field(name) {
  const { kind, choices, help, default: usual, optional } = about.settings[name], value = given(name),
    label = name.replaceAll('_', ' ');
  const on = (event) => choose(name, event.target.value.trim());
  if (kind === 'bool') return h('label', { class: 'field' }, h('span', { class: 'row' }, h('input', { type: 'checkbox',
    checked: value === 'true',
    onchange: (event) => choose(name, event.target.checked ? 'true' : '') }), label), h('small', {}, help));
  const control = choices.length && name !== 'criterion' ? select(label, value, choices.map((choice) => [choice,
    choice]), (chosen) => choose(name, chosen))
    : h('input', { type: kind === 'int' || kind === 'float' ? 'number' : 'text', step: 'any', 'aria-label': label,
      onchange: on,
      value: optional && value === String(usual) ? '' : value });
  return h('label', { class: 'field' }, h('span', {}, label), control, h('small', {}, help));
}

/* ---- parts of steps ---- */
const note = (level, text, ...more) => h('div', { class: `note ${level}`, role: level === 'ERROR' ? 'alert' : 'note' },
  h('p', {}, text), more);
function refusal({ sentence, remedy: options = {}, window = '' }) {
  const correct = Object.keys(options).length > 0, [start, end] = window.split(':');
  return note('ERROR', sentence, (correct || window) && h('div', { class: 'row' },
    correct && button(`Apply ${asOptions(options)}`, () => remedy(options)),
    window && button(`Take the window from ${start} to ${end} s`, () => { Object.assign(state.files[state.shown], {
      start, end }); changed(); })));
}
const more = (summary, ...kids) => h('details', { open: Boolean(state.open?.[summary]),
  ontoggle: (event) => { (state.open ??= {})[summary] = event.target.open; } }, h('summary', {}, summary), kids);
function heading(title, lead) { return [h('h2', {}, title), h('p', { class: 'lead' }, lead)]; }
function actions(next, text, ...more) {
  return h('div', { class: 'actions' }, state.step > 0 && button('Back', () => go(state.step - 1)),
    text && button(text, () => (typeof next === 'function' ? next() : go(state.step + 1)), { class: 'primary',
      disabled: !next }), more);
}
function command(text) {
  const copy = button('Copy', async () => { await navigator.clipboard.writeText(text); copy.textContent = 'Copied'; });
  const lines = text.split('\n').map((line) => h('div', {}, line.split(/ (?=--)/).map((word) => [h('span', {}, word),
    ' '])));
  return h('div', { class: 'command' }, h('code', {}, lines), copy);
}
/* The command line of the present choices, which the server composes. */
function shell() {
  const place = h('div', {});
  if (state.command) place.append(command(state.command));
  fetch(`sessions/${about.session}/command`, { method: 'POST',
    body: JSON.stringify(job()) }).then((answer) => answer.ok && answer.text())
    .then((text) => { if (text) { state.command = text; place.replaceChildren(command(text)); } }, () => {});
  return place;
}
function path(values, low, high, width = 100, height = 30) {
  const scale = high > low ? height / (high - low) : 0;
  return values.map((value,
    k) => `${k ? 'L' : 'M'}${(width * k / (values.length - 1 || 1)).toFixed(2)} ${(height - (value - low) * scale).toFixed(2)}`).join('');
}
function spark(values) {
  if (!values) return '';
  const low = Math.min(...values), high = Math.max(...values);
  return [s('svg', { class: 'spark', viewBox: '0 0 100 30', preserveAspectRatio: 'none', role: 'img',
    'aria-label': `from ${number(low, 3)} to ${number(high, 3)}` },
    s('path', { d: path(values, low, high) })), h('small', {}, `${number(low, 3)} to ${number(high, 3)}`)];
}
/* Runs a task when its step opens and nothing is known yet, and draws the step again. */
async function need(name, files, take) {
  try { take(await task(name, job(files)), null); } catch (error) { if (error.name === 'AbortError') return; take(null,
    error); }
  draw();
}

/* ---- 1: recordings ---- */
async function receive(entries) {
  problem = null;
  for (const { file, name } of entries) {
    const answer = await fetch(`sessions/${about.session}/files/${encodeURIComponent(name).replaceAll('%2F', '/')}`, {
      method: 'PUT', body: file })
      .catch(() => null);
    if (answer?.ok) add((await answer.json()).name);
    else problem = { sentence: answer ? await answer.text() : 'the studio does not answer; is it still running in its terminal?' };
  }
  changed();
}
const add = (name) => { if (!state.files.some((file) => file.name === name)) state.files.push({ name, role: 'estimate',
  start: '', end: '' }); };
async function dropped(items) {
  const found = [], walk = async (entry, folder) => {
    const made = (method) => new Promise((take, refuse) => entry[method](take, refuse));
    if (entry.isFile) found.push({ file: await made('file'), name: folder + entry.name });
    else {
      const reader = entry.createReader(), list = () => new Promise((take, refuse) => reader.readEntries(take, refuse));
      for (let some; (some = await list()).length;) for (const each of some) await walk(each, `${folder}${entry.name}/`);
    }
  };
  /* The items are gone after the first wait. */
  const taken = [...items].filter((item) => item.kind === 'file').map((item) => [item.webkitGetAsEntry(), item.getAsFile()]);
  for (const [entry, file] of taken) if (entry) await walk(entry, ''); else if (file) found.push({ file, name: file.name });
  await receive(found);
}
function recordings() {
  const input = (folder) => h('input', { type: 'file', hidden: true, multiple: true, webkitdirectory: folder || null,
    onchange: (event) => receive([...event.target.files].map((file) => ({ file,
      name: file.webkitRelativePath || file.name }))) });
  const files = input(false), folder = input(true);
  const drop = h('div', { class: 'drop', ondragover: (event) => { event.preventDefault(); drop.classList.add('over'); },
    ondragleave: () => drop.classList.remove('over'), ondrop: (event) => { event.preventDefault();
      drop.classList.remove('over'); dropped(event.dataTransfer.items); } },
    rig(-2.2, 1.1, '-46 -8 60 62'), h('strong', {}, 'Drop recordings here'), h('small', {},
      'A bag (its folder or .mcap), or .csv, .mat, .xlsx, .parquet, .npz'), files, folder,
    h('div', { class: 'row' }, button('Choose files', () => files.click()), button('Choose a bag’s folder',
      () => folder.click()),
      button('Try the sample recording', () => { add('paper_experiment'); changed(); }, { class: 'plain' })));
  const roles = [['estimate', 'estimates'], ['validate', 'only validates']];
  const list = state.files.map((file, k) => {
    const end = (name, label) => h('input', { type: 'number', min: 0, step: 'any', value: file[name],
      placeholder: label, 'aria-label': `${label} of ${file.name} in seconds`,
      onchange: (event) => { file[name] = event.target.value; changed(); } });
    return h('li', {}, h('strong', {}, file.name), select(`role of ${file.name}`, file.role, roles, (role) => {
      file.role = role; changed('roles'); }),
      h('span', { class: 'row' }, end('start', 'start'), '–', end('end', 'end'), h('small', {}, 's')),
      button('Remove', () => { state.files.splice(k, 1); state.shown = 0; changed(); }, { class: 'plain',
        'aria-label': `remove ${file.name}` }));
  });
  return [heading('What was recorded?',
    'Motion of both joints and the torque of the motor. Files stay on this computer.'), problem && refusal(problem),
    drop,
    h('ul', { class: 'files' }, list), list.length > 0 && h('p', {}, h('small', {},
      'Without a window, the first half of one recording estimates and the second validates; several all estimate.')),
    actions(state.files.some((file) => file.role === 'estimate'), 'Continue')];
}

/* ---- 2: columns ---- */
const BOX = '-16 -8 62 60';
const ROWS = [['t', 'Time'], ['q1', 'Shoulder angle'], ['q2', 'Elbow angle'], ['tau1', 'Shoulder torque'], ['tau2',
  'Elbow torque'], ['dq1', 'Shoulder speed'], ['dq2', 'Elbow speed']];
function unit(name) {
  const list = (setting) => about.settings[setting].choices.map((choice) => [choice, choice.replace('us',
    'µs').replace('Nm', 'N m').replace('Ncm', 'N cm').replace('kgfcm', 'kgf cm').replace('ozfin', 'ozf in')]);
  if (name === 't') return select('unit of t', given('time_unit'), list('time_unit'), (value) => choose('time_unit',
    value));
  if (name[0] === 't') return select(`unit of ${name}`, given('torque_unit'), list('torque_unit'),
    (value) => choose('torque_unit', value));
  if (name[0] === 'd') return given('degrees') === 'true' ? 'deg/s' : 'rad/s';
  return select(`unit of ${name}`, given('degrees'), [['false', 'rad'], ['true', 'degrees']],
    (value) => choose('degrees', value === 'true' ? value : ''));
}
function sign(name) {
  const signs = given('negate').split(',').filter(Boolean);
  return select(`sign of ${name}`, String(signs.includes(name)), [['false', '+'], ['true', '− reversed']], (value) =>
    choose('negate', ROWS.map(([each]) => each).filter((each) => (each === name ? value === 'true' : signs.includes(each))).join(',')));
}
function mapping(found) {
  const table = found.columns.length > 0;
  const columns = (name) => select(`column of ${name}`, found.taken[name] ?? '', [['', '–'],
    ...found.columns.map((column) => [column, column])],
    (value) => choose('columns', joined({ ...parsed(state.options.columns), [name]: value })));
  const needed = ['t', 'q1', 'q2', 'tau1'], shown = (name) => needed.includes(name) || found.taken[name] || state.all;
  const rows = ROWS.filter(([name]) => (table ? shown(name) : needed.includes(name) && name !== 't')).map(([name,
    label]) => h('tr', {},
    h('th', { scope: 'row' }, label, h('small', {}, name)), table && h('td', {
      class: needed.includes(name) && !found.taken[name] ? 'wide missing' : 'wide' }, columns(name)),
    h('td', {}, table || name !== 't' ? unit(name) : ''), h('td', {}, /^(q|tau)/.test(name) ? sign(name) : ''), h('td',
      {}, name === 't' ? '' : spark(found.preview?.[name]))));
  const all = table && !state.all && button('Elbow torque and speeds were recorded, too', () => { state.all = true;
    draw(); }, { class: 'plain' });
  return [h('table', { class: 'columns' }, h('thead', {}, h('tr', {}, ['Quantity', table && 'Column', 'Unit', 'Sign',
    'As it is taken, in rad and N m'].filter(Boolean).map((text) => h('th', { scope: 'col' }, text)))), h('tbody', {},
    rows)), all];
}
function convention(name, legend, choices) {
  return h('fieldset', { class: 'choices' }, h('legend', {}, legend), choices.map(([value, text, help,
    picture]) => h('label', { class: 'choice' },
    h('input', { type: 'radio', name, value, checked: given(name) === value, onchange: () => choose(name, value) }),
      picture, h('span', {}, text, h('small', {}, help)))));
}
function columns() {
  const found = state.described, files = state.files.length > 1 && h('div', { class: 'tabs' }, state.files.map((file,
    k) =>
    button(file.name, () => { state.shown = k; state.described = null; draw(); }, {
      'aria-pressed': String(k === state.shown) })));
  const top = [heading('How is it written?',
    'Check that each quantity is the right column, in the right unit and sense. All recordings are read alike.'),
    files];
  const old = state.stale ?? found;
  if (!found && !running) need('describe', [{ ...state.files[state.shown], role: 'estimate' }], (value, error) => {
    state.described = state.stale = value ?? { columns: [], taken: {}, topics: [], joints: [], options: {},
      problem: error };
  });
  if (!old) return [top, h('p', { class: 'busy' }, 'reading'), actions(false, 'Continue')];
  const bag = old.topics.length > 0 && [h('h3', {}, 'Topic and joints'), h('div', { class: 'row' },
    select('topic', state.topic || '/joint_states', old.topics.map((topic) => [topic, topic]), (value) => {
      state.topic = value; changed(); }),
    ['shoulder', 'elbow'].map((joint, k) => select(`joint of the ${joint}`,
      (state.joints || 'shoulder,elbow').split(',')[k],
      old.joints.map((name) => [name, `${joint}: ${name}`]), (value) => {
        const now = (state.joints || 'shoulder,elbow').split(','); now[k] = value; state.joints = now.join(',');
        changed(); })))];
  const hanging = -Math.PI / 2, file = ['decimal', 'skip_rows', 'sheet', 'encoding', 'skip_missing'];
  return [top, found?.problem && refusal(found.problem), found?.taken_as && note('OK', h('span', {},
    'Taken from the file itself: ', h('code', {}, found.taken_as))),
    (found?.survey?.guesses ?? []).map((guess) => note('WARN', guess)), !found && h('p', { class: 'busy' }, 'reading'),
      bag, (old.columns.length > 0 || old.topics.length > 0) && mapping(old),
    convention('zero', 'Where is the shoulder angle zero?', [
      ['horizontal', 'Horizontal', 'at rest it is −90°', rig(-0.9, -0.4, BOX, angle(0, 0, 19, 0, -0.9))],
      ['hanging', 'Hanging', 'at rest it is 0°', rig(-0.9, -0.4, BOX, angle(0, 0, 19, hanging, -0.9))]]),
    convention('elbow', 'What is the elbow angle?', [
      ['relative', 'Relative', 'from the line of link 1', rig(-1.2, 1, BOX, angle(10.1, 26.1, 15, -1.2, -0.2, 24))],
      ['absolute', 'Absolute', 'from the zero of the shoulder', rig(-1.2, 1, BOX, angle(10.1, 26.1, 15, hanging, -0.2,
        24))]]),
    more('Motor current, wrapped angles, offsets, exchanged joints, text and sheets',
      h('div', { class: 'fields' }, ['torque_constant', 'gear', 'unwrap', 'swap', 'offset',
        ...(old.columns.length || !old.topics.length ? file : [])].map(field))),
    actions(found && !found.problem, 'Continue')];
}

/* ---- 3: checks ---- */
const CHECKS = { reading: 'Samples', stamps: 'Time stamps', gaps: 'Gaps', limits: 'Limits', conventions: 'Conventions',
  excitation: 'Excitation' };
const passed = () => state.checks && !state.checks.some((each) => each.level === 'ERROR' && each.check !== 'conventions');
function checks() {
  const top = heading('Is it good enough?', 'Everything that can be checked before a fit.');
  if (!state.checks) {
    if (!running) need('check', state.files, (value, error) => { state.checks = value ?? [{ check: 'reading',
      level: 'ERROR', ...error, remedy: error.remedy ?? {} }]; });
    return [top, h('p', { class: 'busy' }, 'checking stamps, gaps, limits, conventions and excitation'), actions(false,
      'Continue')];
  }
  const list = state.checks.toSorted((a,
    b) => Object.keys(CHECKS).indexOf(a.check) - Object.keys(CHECKS).indexOf(b.check)).map(({ check, level, sentence,
    remedy: options }) =>
    h('li', {}, h('span', { class: `dot ${level}`, role: 'img', 'aria-label': { OK: 'good', WARN: 'warning',
      ERROR: 'error' }[level] }, { OK: '✓', WARN: '!', ERROR: '✕' }[level]),
      h('strong', {}, CHECKS[check]), h('div', {}, h('p', {}, sentence),
        Object.keys(options).length > 0 && button(`Apply ${asOptions(options)}`, () => remedy(options,
        check === 'conventions')))));
  return [top, h('ul', { class: 'checks' }, list), actions(passed(), 'Continue', button('Mend the columns',
    () => go(1)))];
}

/* ---- 4: method ---- */
function method() {
  const cards = [['likelihood', 'Likelihood', 'the best parameters; seconds to a minute'], ['weak', 'Weak form',
    'nearly as good, at once'], ['energy', 'Energy', 'the paper’s, by differential evolution']];
  const models = { auto: 'the smallest that is exact, or else the largest', viscous: 'the paper’s seven parameters',
    coulomb: 'and dry friction', rotor: 'and a rotor at the elbow', geared: 'and friction of gears' };
  const choice = (name, value, text, help) => h('label', { class: 'choice' }, h('input', { type: 'radio', name, value,
    checked: (given(name) || 'likelihood') === value,
    onchange: () => choose(name, name === 'criterion' && value === 'likelihood' ? '' : value) }), h('span', {}, text,
      h('small', {}, help)));
  const rest = ['hold', 'delay', 'link_length', 'sliding', 'optimizer', 'seed', 'spread',
    'apply_remedies'].filter((name) => name in about.settings);
  return [heading('How is it fitted?', 'The defaults suit nearly every rig.'),
    h('fieldset', { class: 'choices' }, h('legend', {}, 'Criterion'), cards.map((card) => choice('criterion',
      ...card))),
    h('fieldset', { class: 'choices' }, h('legend', {}, 'Model'), Object.entries(models).map(([value,
      help]) => choice('model', value, value, help))),
    more('Hold, delay, length of link 1, seed', h('div', { class: 'fields' }, rest.map(field))),
    h('h3', {}, 'The same in a terminal'), shell(), actions(passed(), 'Continue')];
}

/* ---- 5: fit ---- */
async function fit() {
  const began = performance.now(), stages = [];
  Object.assign(state, { result: null, error: null, fitting: { stages } });
  const clock = setInterval(() => { const shown = $('#elapsed');
    if (shown) shown.textContent = `${Math.round((performance.now() - began) / 1000)} s`; }, 250);
  const promise = task('identify', job(), (event) => {
    if (state.fitting.progress && state.fitting.progress !== event.progress && !stages.includes(state.fitting.progress)) stages.push(state.fitting.progress);
    Object.assign(state.fitting, event);
    if (state.step === 4) draw();
  });
  draw();
  try { state.result = await promise; } catch (error) { state.error = error.name === 'AbortError' ? {
    stopped: true } : error; }
  clearInterval(clock);
  state.fitting = null;
  if (state.result && state.step === 4) go(5); else draw();
}
function fitting() {
  const now = state.fitting;
  if (!now) return [heading('Ready', 'The fit runs in a program of its own. It can be stopped at any time.'), shell(),
    state.error?.stopped && note('WARN', 'Stopped. Nothing was kept.'),
    state.error?.sentence && refusal(state.error), actions(passed() && fit, state.result ? 'Fit again' : 'Start')];
  return [heading('Fitting', 'This page shows the result as soon as it is there.'), h('div', { class: 'card' }, h('div',
    { class: 'row' }, h('strong', { class: 'busy', id: 'activity' }, now.progress ?? 'starting'),
    h('span', { class: 'quiet', id: 'elapsed' }, ''), now.best != null && h('span', { class: 'quiet' },
      `J = ${number(now.best, 5)}`)),
  h('progress', { 'aria-label': 'progress of this stage', ...(now.of ? { value: now.done, max: now.of } : {}) }),
    h('ul', { class: 'stages' }, now.stages.slice(-6).map((stage) => h('li', {}, stage)))),
  h('div', { class: 'actions' }, button('Stop', () => running?.abort(), { id: 'stop' }))];
}

/* ---- 6: result ---- */
const FILES = { 'report.html': 'the page', 'result.yaml': 'every number', 'pendubot.xml': 'MuJoCo',
  'pendubot.urdf': 'RViz, Gazebo, Drake',
  'pendubot.yaml': 'a ROS node', 'pendubot.m': 'MATLAB', 'pendubot.h': 'C', 'pendubot.py': 'Python' };
function result() {
  const { level, files, missing } = state.result, at = `sessions/${about.session}/output/`;
  const links = Object.keys(FILES).filter((name) => files.includes(name)).map((name) =>
    h('a', { class: 'button', href: at + name, download: name }, name, h('small', {}, FILES[name])));
  return [h('h2', {}, 'The parameters of the rig'),
    level === 'WARN' && note(level, 'Use them with care: the page says why.'), level === 'ERROR' && note(level,
      'Do not use them: the page says why.'),
  h('iframe', { src: `${at}report.html`, title: 'page of the result',
    sandbox: 'allow-scripts allow-downloads allow-modals' }),
  h('p', {}, h('a', { href: `${at}report.html`, target: '_blank', rel: 'noopener' }, 'Open the page in its own tab')),
  h('h3', {}, 'Take it along'), h('div', { class: 'take' }, links),
  Object.entries(missing).map(([name, sentence]) => h('p', {}, h('small', {}, `${name}: ${sentence}`))),
  h('h3', {}, 'The same in a terminal'),
    command(`${state.command}\npendubot export report/result.yaml --output pendubot.urdf`),
  actions(null, null, button('Another recording', () => location.reload()))];
}

/* ---- the frame ---- */
const DRAW = [recordings, columns, checks, method, fitting, result];
const reachable = (k) => [true, state.files.some((file) => file.role === 'estimate'),
  state.described && !state.described.problem || state.checks, passed(), passed(), state.result][k];
function go(k) { if (!state.fitting) cancel(); state.step = k; draw(); $('#step').focus({ preventScroll: true });
  scrollTo(0, 0); }
function draw() {
  const held = document.activeElement?.getAttribute('aria-label');
  $('#rail').replaceChildren(...STEPS.map((name, k) => h('li', {
    class: reachable(k + 1) && k < state.step ? 'done' : '' },
    button([h('b', {}, reachable(k + 1) && k < state.step ? '✓' : String(k + 1)), h('span', {}, name)], () => go(k), {
      disabled: !reachable(k), 'aria-current': k === state.step ? 'step' : null,
      'aria-label': `step ${k + 1}: ${name}` }))));
  const elapsed = $('#elapsed')?.textContent;
  fill('#step', DRAW[state.step]());
  if (elapsed && $('#elapsed')) $('#elapsed').textContent = elapsed;
  if (held) document.querySelector(`[aria-label="${CSS.escape(held)}"]`)?.focus({ preventScroll: true });
}

/* ---- live ---- */
const HISTORY = 200;
async function live() {
  const traces = { q1: [], q2: [], tau: [] }, watching = live.watching = new AbortController();
  const show = (now) => {
    const { parameters, level, message } = now, here = 'q' in now;
    if (here) for (const [name, value] of [['q1', now.q[0]], ['q2', now.q[1]], ['tau',
      now.effort]]) if (traces[name].push(value) > HISTORY) traces[name].shift();
    const trace = (names) => { const all = names.flatMap((name) => traces[name]), low = Math.min(...all),
      high = Math.max(...all);
      return s('svg', { class: 'trace', viewBox: '0 0 100 30', preserveAspectRatio: 'none', 'aria-hidden': 'true' },
        names.map((name) => s('path', { class: name, d: path(traces[name], low, high > low ? high : low + 1,
        100 * traces[name].length / HISTORY) }))); };
    const figure = (label, value, measure) => h('div', {}, h('dt', {}, label), h('dd', {}, value, ' ', h('small', {},
      measure)));
    const size = here ? Math.sign(now.effort) : 0;
    const torque = size !== 0 && s('path', { class: 'arc',
      d: `M${13 * size} -9 A16 16 0 0 ${size > 0 ? 0 : 1} ${-13 * size} -9 m${-1.5 * size} -5 l${1.5 * size} 5 l${5 * size} -2` });
    const gravity = s('path', { class: 'thin', d: 'M50 -52 V-36 m-3 -5 l3 5 l3 -5' });
    const rows = parameters.map(({ name, value, half, unit: measure }) => h('tr', {}, h('th', { scope: 'row' }, name),
      h('td', {}, number(value)),
      h('td', {}, half == null ? '–' : `± ${number(half, 2)}`), h('td', { class: 'text' }, (measure ?? '').replace('^2',
        '²')),
      h('td', {}, half != null && h('meter', { min: 0, max: 1, value: Math.min(1, Math.abs(half / value)),
        'aria-label': `half-width of ${name} in parts of it` }))));
    const head = ['', 'value', '95 % interval', 'unit', '± of value'].map((text) => h('th', { scope: 'col',
      class: text === 'unit' ? 'text' : null }, text));
    const lead = here ? 'As it is published now. This page only listens.' : 'No joint states are published. Start the bridge.';
    fill('#live', h('h2', {}, 'The running rig'), h('p', { class: 'lead' }, lead),
      level && note(level, h('strong', {}, level), message && ` ${message}`), !level && message && note('ERROR',
        message),
      h('div', { class: 'watch' }, h('div', { class: 'card' }, rig(...(here ? now.q : [-Math.PI / 2, 0]),
        '-58 -58 116 116', torque, gravity, s('text', { x: 40, y: -41 }, 'g'))),
        here && h('div', { class: 'card' }, h('dl', { class: 'figures' }, figure('q1', number(now.q[0], 3), 'rad'),
          figure('q2', number(now.q[1], 3), 'rad'),
          figure('effort', number(now.effort, 3), 'N m'), figure('samples', now.rate.toFixed(0), 'Hz')), trace(['q1',
            'q2']), trace(['tau']),
        [['q1', 'q1'], ['q2', 'q2'], ['tau', 'effort']].map(([name, text]) => h('span', { class: `key ${name}` },
          text)))),
      h('div', { class: 'card' }, rows.length ? h('table', { class: 'numbers' }, h('thead', {}, h('tr', {}, head)),
        h('tbody', {}, rows))
        : h('p', { class: 'quiet' }, 'No parameters are published. Start the identifier or the tracker.')));
  };
  $('#live').replaceChildren(h('p', { class: 'busy' }, 'listening'));
  try {
    await follow('live', null, watching.signal, (event) => { live.count = (live.count ?? 0) + 1;
      $('#live').dataset.lines = live.count; if (event.problem) throw event.problem;
      if ('parameters' in event) show(event); });
  } catch (error) { if (error.name !== 'AbortError') $('#live').replaceChildren(refusal(error)); }
}
function view(name) {
  live.watching?.abort();
  for (const each of ['steps', 'live']) { $(`#${each}`).hidden = each !== name;
    $(`#to-${each}`).setAttribute('aria-pressed', String(each === name)); }
  if (name === 'live') live();
}
async function start() {
  const answer = await fetch('sessions', { method: 'POST' });
  if (!answer.ok) { $('#step').replaceChildren(refusal({ sentence: await answer.text() })); return; }
  about = await answer.json();
  about.given.forEach(add);
  $('#to-live').hidden = !about.live;
  for (const name of ['steps', 'live']) $(`#to-${name}`).addEventListener('click', () => view(name));
  addEventListener('dragover', (event) => event.preventDefault());
  addEventListener('drop', (event) => event.preventDefault());
  addEventListener('pagehide', () => navigator.sendBeacon(`sessions/${about.session}/end`));
  addEventListener('pageshow', (event) => { if (event.persisted) location.reload(); });
  draw();
  if (location.hash === '#live' && about.live) view('live');
}
start();
