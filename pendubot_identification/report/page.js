// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0

// Makes the plots over time of a report explorable, simulates the rig, and moves it. The JSON block "content" is of
// page.py; "acceleration", the rig's equations of motion, by formats/code.py. All plots share one time axis: what one
// shows, all others show, unless they have nothing there.
'use strict';
(() => {
  const { plots, rig } = JSON.parse(document.getElementById('content').textContent);
  const panels = [];
  const GUTTER = 54, INK = '#1a1a1a', PALE = '#dddddd', FONT = '11px system-ui, sans-serif';
  let animate = () => {};
  const element = (tag, parent, text = '', others = {}) => {
    const made = document.createElement(tag);
    made.textContent = text;
    parent.append(made);
    return Object.assign(made, others);
  };
  const button = (parent, text, title, act) => {
    const made = element('button', parent, text, { type: 'button', title });
    if (text.length < 2) made.ariaLabel = title;
    made.addEventListener('click', act);
    return made;
  };
  const svg = (parent, tag, attributes, text = '') => {
    const made = document.createElementNS('http://www.w3.org/2000/svg', tag);
    for (const [key, each] of Object.entries(attributes)) made.setAttribute(key, each);
    made.textContent = text;
    parent?.append(made);
    return made;
  };
  const signed = (number) => String(number).replace('-', '−');
  document.documentElement.classList.add('scripted');

  function zoom(low, high) {
    for (const { chart, extent: [first, last] } of panels) {
      if (low === null) chart.setScale('x', { min: first, max: last });
      else if (low < last && high > first) chart.setScale('x', { min: low, max: high });
    }
  }
  const shown = ({ chart }) => [chart.scales.x.min, chart.scales.x.max];
  function widen(panel, factor) {
    const [low, high] = shown(panel), [first, last] = panel.extent;
    const middle = (low + high) / 2, reach = (high - low) / 2 * factor;
    const [a, b] = [middle - reach, middle + reach];
    if (b - a >= last - first) zoom(null);
    else if (b - a > 1e-3 * (last - first)) zoom(a, b); // the data are thinned: closer there is nothing to see
  }
  function shift(panel, distance) {
    const [low, high] = shown(panel), [first, last] = panel.extent;
    const by = Math.max(Math.min(distance, last - high), first - low);
    zoom(low + by, high + by);
  }

  // The value of a line at a time, between its points; null outside and in its gaps.
  function value(line, t) {
    let k = -1, n = line.t.length;
    while (n - k > 1) {
      const middle = (k + n) >> 1;
      if (line.t[middle] > t) n = middle; else k = middle;
    }
    if (k < 0 || (n === line.t.length && t > line.t.at(-1))) return null;
    n = Math.min(n, line.t.length - 1);
    const [a, b] = [line.y[k], line.y[n]];
    if (a !== null && (line.style === 'steps' || k === n)) return a;
    if (a !== null && b !== null) return a + (b - a) * (t - line.t[k]) / (line.t[n] - line.t[k]);
    return t - line.t[k] < line.t[n] - t ? a : b;
  }

  // Writes the values at a time above each panel, and poses the rig.
  function read(panel, t) {
    for (const [line, output] of panel.outputs) {
      const at = t === null ? null : value(line, t);
      output.textContent = at === null ? '' : signed(at.toPrecision(4));
    }
    if (t !== null) animate(t);
  }

  function series(line) {
    const own = { stroke: line.colour, width: line.style === 'band' ? 0 : line.width, points: { show: false } };
    if (line.style === 'steps') own.paths = uPlot.paths.stepped({ align: 1 });
    if (line.style === 'dots') Object.assign(own, { paths: () => null, points: { show: true, size: 5, fill: line.colour } });
    return own;
  }

  function legend(head, colour, label, name = 'swatch') {
    const item = element('span', head);
    element('i', item, '', { className: name }).style.background = colour;
    item.append(label);
    return item;
  }

  // Shades spans below the lines, and draws above them where recordings begin.
  function shade({ ctx, bbox, valToPos }, spans) {
    const place = (t) => Math.min(Math.max(valToPos(t, 'x', true), bbox.left), bbox.left + bbox.width);
    for (const [begin, end, colour] of spans) {
      ctx.fillStyle = colour + '2e';
      ctx.fillRect(place(begin), bbox.top, place(end) - place(begin), bbox.height);
    }
  }
  function mark({ ctx, bbox, scales, valToPos }, boundaries) {
    ctx.save();
    Object.assign(ctx, { fillStyle: '#777777', strokeStyle: '#777777', textAlign: 'left' });
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    ctx.setLineDash([4, 4]);
    boundaries.forEach((begin, k) => {
      if (begin < scales.x.min || begin > scales.x.max) return;
      const x = valToPos(begin, 'x', true);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      ctx.fillText(k + 1, x + 4, bbox.top + 12 * devicePixelRatio);
    });
    ctx.restore();
  }

  function addPanel(box, plot, data, last, extent) {
    const head = element('div', box, '', { className: 'head' });
    element('b', head, data.label);
    const panel = { extent, data };
    panel.outputs = data.lines.filter((line) => line.style !== 'dots').map((line) => [
      line, element('output', legend(head, line.colour, line.label)),
    ]);
    panel.fit = element('b', head, '', { className: 'fit' });
    const lines = [{}], bands = [];
    // Lines on the same times need not be joined.
    panel.table = () => (data.lines.every((line) => line.t === data.lines[0].t)
      ? [data.lines[0].t, ...data.lines.map((line) => line.y)]
      : uPlot.join(data.lines.map((line) => (line.upper ? [line.t, line.y, line.upper] : [line.t, line.y]))));
    for (const line of data.lines) {
      lines.push(series(line));
      if (line.upper) {
        lines.push(series(line));
        bands.push({ series: [lines.length - 1, lines.length - 2], fill: line.colour + '40' });
      }
    }
    const within = (chart, low, high) => {
      const [least, most] = data.reach || [-Infinity, Infinity];
      if (low === null || low === undefined) return data.reach || [-1, 1];
      const space = 0.05 * (high - low) || Math.abs(high) || 1;
      return [Math.max(low - space, least), Math.min(high + space, most)];
    };
    const tick = { stroke: INK, font: FONT, grid: { stroke: PALE, width: 1 }, ticks: { show: false } };
    const followed = ['mousemove', 'mouseleave'];
    panel.chart = new uPlot({
      width: Math.max(box.clientWidth, 200), height: last ? 138 : 104, legend: { show: false }, bands, series: lines,
      padding: [4, 10, last ? 0 : 4, 0],
      scales: { x: { time: false, min: extent[0], max: extent[1] }, y: { range: within } },
      axes: [last ? { ...tick, label: 'time [s]', labelFont: FONT, labelSize: 16, size: 24 } : { ...tick, size: 0, values: () => [] },
        { ...tick, size: GUTTER, space: 26, values: (chart, ticks) => ticks.map((y) => signed(+y.toPrecision(6))) }],
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false },
        sync: { key: 'time', filters: { pub: (kind) => followed.includes(kind) } },
        bind: { dblclick: () => () => { zoom(null); return null; },
          mousedown: (chart, target, handle) => (event) => { if (!event.shiftKey) handle(event); return null; } } },
      hooks: {
        setSelect: [(chart) => {
          const { left, width } = chart.select;
          if (width > 3) zoom(chart.posToVal(left, 'x'), chart.posToVal(left + width, 'x'));
          chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        setCursor: [({ cursor, posToVal }) => read(panel, cursor.left >= 0 ? posToVal(cursor.left, 'x') : null)],
        drawClear: [(chart) => shade(chart, plot.spans)],
        draw: [(chart) => mark(chart, plot.boundaries)],
      },
    }, panel.table(), box);
    panels.push(panel);

    const over = panel.chart.over;
    let held = null;
    over.addEventListener('pointerdown', (event) => {
      if (event.shiftKey || event.pointerType === 'touch') held = event.clientX;
    });
    addEventListener('pointermove', (event) => {
      if (held === null) return;
      const [low, high] = shown(panel);
      shift(panel, (held - event.clientX) / over.clientWidth * (high - low));
      held = event.clientX;
    });
    for (const end of ['pointerup', 'pointercancel']) addEventListener(end, () => { held = null; });
    return panel;
  }

  function addPlot(box, plot) {
    const tools = element('div', box, '', { className: 'tools' });
    const times = plot.panels.flatMap((panel) => panel.lines.flatMap((line) => [line.t[0], line.t.at(-1)])).filter(isFinite);
    const extent = [Math.min(...times), Math.max(...times)];
    const kinds = new Map(plot.spans.filter(([, , , label]) => label).map(([, , colour, label]) => [label, colour]));
    for (const [label, colour] of kinds) legend(tools, colour + '66', label, 'swatch broad');
    const own = plot.panels.map((data, k) => addPanel(box, plot, data, k === plot.panels.length - 1, extent));
    const quarter = () => (shown(own[0])[1] - shown(own[0])[0]) / 4;
    const acts = [
      ['−', 'zoom out', '-', () => widen(own[0], 1.6)], ['+', 'zoom in', '+', () => widen(own[0], 1 / 1.6)],
      ['‹', 'earlier', 'ArrowLeft', () => shift(own[0], -quarter())],
      ['›', 'later', 'ArrowRight', () => shift(own[0], quarter())],
      ['all', 'show all', 'Home', () => zoom(null)],
    ];
    for (const [sign, title, , act] of acts) button(tools, sign, title, act);
    box.tabIndex = 0;
    box.addEventListener('keydown', (event) => {
      const found = event.target === box && acts.find(([, , key]) => key === event.key);
      if (found) { event.preventDefault(); found[3](); }
    });
    box.panels = own;
    box.charts = own.map(({ chart }) => chart);
    box.draw = (height) => drawing(plot, own, height);
    const fit = () => box.charts.forEach((chart) => {
      const width = box.clientWidth;
      if (width && chart.width !== width) chart.setSize({ width, height: chart.height });
    });
    new ResizeObserver(fit).observe(box);
  }

  // A plot as SVG, as it is zoomed, in the colours of paper.
  function drawing(plot, own, height = 84) {
    const width = 720, right = width - 10, size = { width, height: (height + 22) * own.length + 26 };
    const how = { 'font-family': 'system-ui, sans-serif', 'font-size': 11, fill: INK };
    const root = svg(null, 'svg', { ...size, viewBox: `0 0 ${width} ${size.height}`, ...how });
    const text = (x, y, words, others = {}) => svg(root, 'text', { x, y: y + 4, ...others }, words);
    const middle = { 'text-anchor': 'middle' };
    svg(root, 'rect', { ...size, fill: '#fff' });
    own.forEach(({ chart, data }, number) => {
      const top = 18 + number * (height + 22), low = top + height, [across, up] = chart.axes;
      const place = ({ min, max }, from, to) => (v) => +(from + (v - min) / (max - min) * (to - from)).toFixed(1);
      const X = place(chart.scales.x, GUTTER, right), Y = place(chart.scales.y, low, top);
      const box = { x: GUTTER, y: top, width: right - GUTTER, height };
      const inside = svg(root, 'svg', { ...box, viewBox: Object.values(box).join(' ') });
      const stroke = (d, colour, others) => svg(inside, 'path', { d, fill: 'none', stroke: colour, ...others });
      for (const [begin, end, fill] of plot.spans) {
        svg(inside, 'rect', { x: X(begin), y: top, width: X(end) - X(begin), height, fill, 'fill-opacity': 0.18 });
      }
      for (const v of across._splits) stroke(`M${X(v)} ${top}V${low}`, PALE);
      for (const v of up._splits) stroke(`M${GUTTER} ${Y(v)}H${right}`, PALE);
      for (const { t, y, upper, style, colour, width: thick } of data.lines) {
        const point = (k) => {
          if (y[k] === null) return '';
          const at = `${X(t[k])} ${Y(y[k])}`;
          if (style === 'dots') return `M${at}h.01`;
          if (!k || y[k - 1] === null) return `M${at}`;
          return style === 'steps' ? `H${X(t[k])}V${Y(y[k])}` : `L${at}`;
        };
        const d = t.map((_, k) => point(k)).join('');
        const back = upper ? t.map((at, k) => `L${X(at)} ${Y(upper[k])}`).reverse().join('') : '';
        if (upper) svg(inside, 'path', { d: `${d}${back}z`, fill: colour, 'fill-opacity': 0.25 });
        else stroke(d, colour, { 'stroke-width': style === 'dots' ? 4 : thick, 'stroke-linecap': 'round' });
      }
      up._splits.forEach((v, k) => {
        if (Y(v) > top && Y(v) < low) text(GUTTER - 5, Y(v), up._values[k], { 'text-anchor': 'end' });
      });
      text(GUTTER, top - 9, data.label, { 'font-weight': 'bold' });
      let x = GUTTER + 8 * data.label.length + 12;
      for (const { label, colour } of data.lines.filter((line) => line.label)) {
        svg(root, 'rect', { x, y: top - 11, width: 14, height: 3, fill: colour });
        text(x + 18, top - 9, label);
        x += 7 * label.length + 34;
      }
      if (number < own.length - 1) return;
      across._splits.forEach((v, k) => text(X(v), low + 9, across._values[k], middle));
      text((GUTTER + right) / 2, low + 23, 'time [s]', middle);
    });
    return new XMLSerializer().serializeToString(root);
  }

  const download = (name, href) => Object.assign(document.createElement('a'), { download: name, href }).click();

  // Saves a figure, by the address of its SVG, as SVG or as PNG of twice its size.
  async function save(name, source, kind) {
    if (kind === 'SVG') { download(`${name}.svg`, source); return; }
    const image = Object.assign(new Image(), { src: source });
    await image.decode();
    const canvas = document.createElement('canvas'), ctx = canvas.getContext('2d');
    Object.assign(canvas, { width: 2 * image.width, height: 2 * image.height });
    ctx.fillStyle = '#fff';
    ctx.fillRect(0, 0, canvas.width, canvas.height);
    ctx.drawImage(image, 0, 0, canvas.width, canvas.height);
    download(`${name}.png`, canvas.toDataURL('image/png'));
  }

  // The state one classic Runge-Kutta step of h [s] later, as in rollout.py.
  function advance(p, [q1, q2, v1, v2], t1, t2, h) {
    const half = h / 2, sixth = h / 6;
    const [k1, l1] = acceleration(p, q1, q2, v1, v2, t1, t2);
    const u1 = v1 + half * k1, u2 = v2 + half * l1;
    const [k2, l2] = acceleration(p, q1 + half * v1, q2 + half * v2, u1, u2, t1, t2);
    const w1 = v1 + half * k2, w2 = v2 + half * l2;
    const [k3, l3] = acceleration(p, q1 + half * u1, q2 + half * u2, w1, w2, t1, t2);
    const [k4, l4] = acceleration(p, q1 + h * w1, q2 + h * w2, v1 + h * k3, v2 + h * l3, t1, t2);
    return [q1 + h * (v1 + sixth * (k1 + k2 + k3)), q2 + h * (v2 + sixth * (l1 + l2 + l3)),
      v1 + sixth * (k1 + 2 * (k2 + k3) + k4), v2 + sixth * (l1 + 2 * (l2 + l3) + l4)];
  }
  // The states of all steps from x on.
  function simulate(p, x, [tau1, tau2], h, first = 0, steps = tau1.length) {
    const states = [x];
    for (let k = first; k < first + steps; k += 1) {
      x = advance(p, x, tau1[k], tau2[k], h);
      states.push(x);
    }
    return states;
  }

  // The measured motion of a plot, and its simulation from a chosen start, again and again every so many steps.
  function addSimulation(plot) {
    const { first, step, states, tau, scale, every } = plot.live, last = states[0].length - 1;
    const t = states[0].map((_, k) => first + k * step), scaled = plot.panels.map(({ power }) => 10 ** power);
    const errors = plot.panels.slice(4).flatMap(({ lines }) => lines);
    for (const { lines } of plot.panels) for (const line of lines) Object.assign(line, { t, y: t.map(() => null) });
    states.forEach((state, j) => { plot.panels[j].lines[0].y = state.map((x) => x / scaled[j]); });
    const measured = t.map((_, k) => states.map((state) => state[k]));
    const live = { t, step, tau, measured, simulated: [], p: [...rig.vectors.identified], start: 0, every, fit: [] };
    live.update = () => {
      for (const { lines } of plot.panels) for (const { label, y } of lines) if (label !== 'measured') y.fill(null);
      live.simulated = [];
      const squares = [0, 0, 0, 0];
      for (let begin = live.start, steps; begin < last; begin += steps) {
        steps = Math.min(live.every, last - begin);
        const found = simulate(live.p, measured[begin], tau, step, begin, steps);
        const shown = begin + steps < last ? steps - 2 : steps; // a gap before the next simulation
        found.forEach((x, k) => { if (Number.isFinite(x[0] + x[1])) live.simulated[begin + k] = x; });
        for (let j = 0; j < 4; j += 1) {
          const { lines: [, simulated, dots], reach } = plot.panels[j], far = 20 * (reach[1] - reach[0]) * scaled[j];
          dots.y[begin] = states[j][begin] / scaled[j];
          for (let k = 0; k <= steps; k += 1) {
            const off = found[k][j] - states[j][begin + k];
            squares[j] += k ? Math.min(off * off || (off === 0 ? 0 : 1e6), 1e6) : 0;
            if (k > shown || !(Math.abs(off) < far)) continue;
            simulated.y[begin + k] = found[k][j] / scaled[j];
            errors[j].y[begin + k] = off / scaled[4 + (j >> 1)];
          }
        }
      }
      live.fit = squares.map((sum, j) => 100 * (1 - Math.sqrt(sum / (last - live.start)) / scale[j]));
    };
    live.update();
    return live;
  }

  // Draws the rig at a time: both poses, the tips' way of the last half second, and the torque.
  function poser(live) {
    const scene = document.getElementById('scene'), find = (name) => scene.querySelectorAll(name);
    const [l1, l2] = rig.lengths.map((length) => 100 * length / (rig.lengths[0] + rig.lengths[1]));
    const torque = Math.max(...live.tau[0].map(Math.abs), 1e-9);
    const [arc] = find('path.torque'), [label] = find('text.torque');
    const joints = ([q1, q2]) => {
      const x = l1 * Math.cos(q1), y = -l1 * Math.sin(q1);
      return [x, y, x + l2 * Math.cos(q1 + q2), y - l2 * Math.sin(q1 + q2)].map((each) => each.toFixed(2));
    };
    const pose = (states, t) => {
      const place = (t - live.t[0]) / live.step + 1e-6, k = Math.floor(place), next = states[k + 1] ?? states[k];
      return states[k]?.slice(0, 2).map((q, j) => q + (place - k) * (next[j] - q));
    };
    return (t) => {
      const poses = [['ghost', live.measured], ['simulated', live.simulated]].map(([name, states]) => {
        const q = pose(states, t), [group] = find(`g.${name}`), [way] = find(`.trace.${name}`);
        group.style.display = q ? '' : 'none';
        const [x, y, ...tip] = joints(q ?? [0, 0]);
        group.firstElementChild.setAttribute('points', `0,0 ${x},${y} ${tip}`);
        group.lastElementChild.setAttribute('cx', x);
        group.lastElementChild.setAttribute('cy', y);
        const before = Array.from({ length: 26 }, (_, k) => pose(states, t - 0.02 * k)).filter(Boolean);
        way.setAttribute('points', before.map((each) => joints(each).slice(2)).join(' '));
        return q;
      });
      const tau = live.tau[0][Math.min(Math.floor((t - live.t[0]) / live.step + 1e-6), live.tau[0].length - 1)];
      const turn = -2.6 * tau / torque;
      const tip = [17 * Math.sin(turn), -17 * Math.cos(turn)].map((each) => each.toFixed(2));
      arc.style.display = Math.abs(turn) < 0.05 ? 'none' : '';
      arc.setAttribute('d', `M0 -17A17 17 0 0 ${turn > 0 ? 1 : 0} ${tip.join(' ')}`);
      label.textContent = tau ? `${signed(tau.toPrecision(2))} N m` : '';
      scene.dataset.poses = JSON.stringify(poses);
    };
  }

  function addPlayer(stage, live, chart, refresh) {
    const find = (tag) => stage.querySelectorAll(`.player ${tag}`);
    const [play, from] = find('button'), [speed, again] = find('select');
    const [scrub] = find('input'), [clock] = find('output');
    play.addEventListener('click', () => (before === null ? run() : stop()));
    from.addEventListener('click', () => {
      live.start = Math.min(Math.round((now - live.t[0]) / live.step), live.t.length - 2);
      now = live.t[live.start];
      refresh();
    });
    again.value = live.every * live.step;
    again.addEventListener('change', () => {
      live.every = Math.max(1, Math.round(again.value / live.step));
      refresh();
    });
    const first = live.t[0], last = live.t.at(-1), draw = poser(live);
    Object.assign(scrub, { min: first, max: last });
    let before = null, now = first;
    animate = (at) => {
      now = Math.min(Math.max(at, first), last);
      scrub.value = now;
      clock.textContent = `${now.toFixed(2)} s`;
      draw(now);
    };
    const show = (t) => {
      if (chart) chart.setCursor({ left: chart.valToPos(t, 'x'), top: 0 }, true, true);
      animate(t);
    };
    const stop = () => { before = null; play.textContent = '▶ play'; };
    const step = (time) => {
      if (before === null) return;
      const t = now + (time - before) / 1000 * speed.value;
      before = time;
      show(Math.min(t, last));
      if (t >= last) stop(); else requestAnimationFrame(step);
    };
    const run = () => {
      if (now >= last - 0.01) now = live.t[live.start];
      play.textContent = '❚❚ stop';
      before = performance.now();
      requestAnimationFrame(step);
    };
    scrub.addEventListener('input', () => { stop(); show(Number(scrub.value)); });
    animate(first);
    if (!matchMedia('(prefers-reduced-motion: reduce)').matches) run();
    return () => animate(now);
  }

  // A slider for each parameter, within its interval or beyond; what is simulated is simulated again at once.
  function addSliders(box, live, refresh) {
    const { names, vectors, intervals } = rig, identified = vectors.identified;
    const rows = [...box.querySelectorAll('.slider')].map((label) => {
      const slider = label.querySelector('input'), output = label.querySelector('output'), { name } = label.dataset;
      const k = names.indexOf(name), [low, high] = intervals[name];
      const bound = (wide) => {
        const reach = wide ? Math.max(5 * (high - low), Math.abs(identified[k])) : 0;
        const [min, max] = wide ? [identified[k] - reach, identified[k] + reach] : [low, high];
        Object.assign(slider, { min, max, value: live.p[k] });
      };
      slider.addEventListener('input', () => { live.p[k] = Number(slider.value); later(); });
      const show = () => {
        slider.value = live.p[k];
        output.textContent = signed(live.p[k].toPrecision(4));
      };
      const limit = () => { live.p[k] = Math.min(Math.max(live.p[k], low), high); };
      return { bound, show, limit };
    });
    const wide = box.querySelector('[type=checkbox]'), said = box.querySelector('[role=status]');
    for (const each of box.querySelectorAll('[data-vector]')) {
      each.addEventListener('click', () => {
        const { vector } = each.dataset;
        if (vector !== 'identified') { wide.checked = true; rows.forEach(({ bound }) => bound(true)); }
        live.p = [...vectors[vector]];
        now();
      });
    }
    wide.addEventListener('change', () => {
      rows.forEach(({ bound, limit }) => {
        if (!wide.checked) limit();
        bound(wide.checked);
      });
      now();
    });
    const words = 'Each slider moves one parameter within its 95 % interval. Correlated parameters only fit together.';
    let waiting = false;
    const now = () => {
      waiting = false;
      const [P1, P2, P3] = live.p, physical = P1 > 0 && P2 > 0 && P1 * P2 > P3 * P3;
      rows.forEach(({ show }) => show());
      const text = physical ? words : 'No rig can have these parameters: M(q) is not positive definite.';
      if (said.textContent !== text) said.textContent = text;
      refresh();
    };
    const later = () => { if (!waiting) { waiting = true; requestAnimationFrame(now); } };
    rows.forEach(({ bound }) => bound(false));
    now();
  }

  const boxes = [...document.querySelectorAll('[data-plot]')];
  const live = plots.simulation?.live && rig ? addSimulation(plots.simulation) : null;
  for (const box of boxes) addPlot(box, plots[box.dataset.plot]);
  if (live) {
    const box = boxes.find((each) => each.dataset.plot === 'simulation');
    let pose = () => {};
    const refresh = (change = true) => {
      if (change) live.update();
      box.panels.forEach((panel, k) => {
        const [min, max] = shown(panel);
        panel.chart.setData(panel.table(), !Number.isFinite(min));
        if (Number.isFinite(min)) panel.chart.setScale('x', { min, max });
        if (k < 4) panel.fit.textContent = `fit ${live.fit[k] > -1000 ? signed(live.fit[k].toFixed(1)) : '—'} %`;
      });
      pose();
    };
    pose = addPlayer(document.querySelector('.stage'), live, box.charts[0], refresh);
    addSliders(document.querySelector('.controls'), live, refresh);
    window.pendubot = { live, refresh, simulate };
  }
  for (const figure of document.querySelectorAll('figure[data-name]')) {
    const tools = element('div', figure, '', { className: 'tools save' }), { name } = figure.dataset;
    const box = boxes.find((each) => figure.contains(each));
    const image = figure.querySelector('img');
    const source = () => (box ? `data:image/svg+xml,${encodeURIComponent(box.draw())}` : image.src);
    for (const kind of ['SVG', 'PNG']) button(tools, kind, `save ${name} as ${kind}`, () => save(name, source(), kind));
  }
  for (const each of document.querySelectorAll('[data-copy]')) {
    each.addEventListener('click', async () => {
      await navigator.clipboard.writeText(each.dataset.copy);
      each.textContent = 'copied';
    });
  }

  // On paper, plots over time are drawings.
  addEventListener('beforeprint', () => boxes.forEach((box) => {
    box.insertAdjacentHTML('afterend', `<div class="printed">${box.draw(42)}</div>`);
  }));
  addEventListener('afterprint', () => document.querySelectorAll('.printed').forEach((each) => each.remove()));
})();
