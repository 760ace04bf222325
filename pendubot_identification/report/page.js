// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0

// Makes the plots over time of a report interactive, simulates the rig, and moves it. page.py writes the JSON block
// "content"; formats/code.py writes "acceleration", the equations of motion. All plots share one time axis: each shows
// the same interval, unless it has no data there.
'use strict';
(() => {
  const { plots, rig } = JSON.parse(document.getElementById('content').textContent);
  const panels = [];
  const GUTTER = 62, INK = '#1a1a1a', PALE = '#dddddd', FONT = '11px system-ui, sans-serif';
  let animate = () => {};
  const element = (tag, parent, text = '', others = {}) => {
    const child = Object.assign(document.createElement(tag), { textContent: text, ...others });
    parent.append(child);
    return child;
  };
  const button = (parent, text, title, act) =>
    element('button', parent, text, { type: 'button', title, ariaLabel: title, onclick: act });
  const signed = (number) => String(number).replace('-', '−');
  document.documentElement.classList.add('scripted');

  function zoom(low, high) {
    for (const { chart, extent: [first, last] } of panels) {
      if (low === null) chart.setScale('x', { min: first, max: last });
      else if (low < last && high > first) chart.setScale('x', { min: low, max: high });
    }
  }
  // Widens the shown interval of a panel by a factor, and moves it by a fraction of its length.
  function move({ chart, extent: [first, last] }, factor, part) {
    const { min, max } = chart.scales.x, all = last - first;
    const width = Math.min(Math.max((max - min) * factor, 1e-3 * all), all); // the thinned data have no finer detail
    const low = (min + max - width) / 2 + part * (max - min), begin = Math.min(Math.max(low, first), last - width);
    if (width < all) zoom(begin, begin + width); else zoom(null);
  }

  // Writes the values nearest to a time above each panel, and poses the rig.
  function read({ chart, outputs }, t) {
    for (const [{ y }, output] of outputs) {
      const at = t === null ? null : y[chart.valToIdx(t)];
      output.textContent = at === null ? '' : signed(at.toPrecision(4));
    }
    if (t !== null) animate(t);
  }

  function series(line) {
    const how = { stroke: line.colour, width: line.style === 'band' ? 0 : line.width, points: { show: false } };
    if (line.style === 'steps') how.paths = uPlot.paths.stepped({ align: 1 });
    if (line.style === 'dots') Object.assign(how, { paths: () => null, points: { show: true, size: 5, fill: line.colour } });
    return how;
  }

  function legend(head, colour, label, name = 'swatch') {
    const item = element('span', head);
    element('i', item, '', { className: name }).style.background = colour;
    item.append(label);
    return item;
  }

  // Shades spans below the lines; a span of length 0 is a line.
  function shade({ ctx, bbox, scales, valToPos }, spans) {
    const place = (t) => valToPos(Math.min(Math.max(t, scales.x.min), scales.x.max), 'x', true);
    for (const [begin, end, colour] of spans) {
      if (end < scales.x.min || begin > scales.x.max) continue;
      ctx.fillStyle = colour;
      ctx.fillRect(place(begin), bbox.top, Math.max(place(end) - place(begin), 1), bbox.height);
    }
  }

  function addPanel(box, plot, data, last, extent) {
    const head = element('div', box, '', { className: 'head' });
    element('b', head, data.label);
    const panel = { extent, data };
    panel.outputs = data.lines.filter(({ style }) => style !== 'dots' && style !== 'band').map((line) => [
      line, element('output', legend(head, line.colour, line.label)),
    ]);
    panel.fit = element('b', head, '', { className: 'fit' });
    panel.table = () => [data.t, ...data.lines.flatMap(({ y, upper }) => (upper ? [y, upper] : [y]))];
    const lines = [{}, ...data.lines.flatMap((line) => (line.upper ? [series(line), series(line)] : [series(line)]))];
    // A band is the first line of its panel.
    const bands = data.lines.filter(({ upper }) => upper).map(({ colour }) => ({ series: [2, 1], fill: colour + '40' }));
    const tick = { stroke: INK, font: FONT, grid: { stroke: PALE, width: 1 }, ticks: { show: false } };
    const followed = ['mousemove', 'mouseleave'];
    panel.chart = new uPlot({
      width: Math.max(box.clientWidth, 200), height: last ? 138 : 104, legend: { show: false }, bands, series: lines,
      padding: [4, 10, last ? 0 : 4, 0],
      scales: { x: { time: false, min: extent[0], max: extent[1] }, y: data.reach ? { range: data.reach } : {} },
      axes: [last ? { ...tick, label: 'time [s]', labelFont: FONT, labelSize: 16, size: 24 } : { ...tick, size: 0, values: () => [] },
        { ...tick, size: GUTTER, space: 26, values: (chart, ticks) => ticks.map((y) => signed(+y.toPrecision(6))) }],
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false },
        sync: { key: 'time', filters: { pub: (kind) => followed.includes(kind) } },
        bind: { dblclick: () => () => { zoom(null); return null; } } },
      hooks: {
        setSelect: [(chart) => {
          const { left, width } = chart.select;
          if (width > 3) zoom(chart.posToVal(left, 'x'), chart.posToVal(left + width, 'x'));
          chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        setCursor: [({ cursor, posToVal }) => read(panel, cursor.left >= 0 ? posToVal(cursor.left, 'x') : null)],
        drawClear: [(chart) => shade(chart, plot.spans)],
      },
    }, panel.table(), box);
    panels.push(panel);
    return panel;
  }

  function addPlot(box, plot) {
    const tools = element('div', box, '', { className: 'tools' });
    const times = plot.panels.flatMap(({ t }) => [t[0], t.at(-1)]).filter(isFinite);
    const extent = [Math.min(...times), Math.max(...times)];
    const kinds = new Map(plot.spans.filter(([, , , label]) => label).map(([, , colour, label]) => [label, colour]));
    for (const [label, colour] of kinds) legend(tools, colour, label, 'swatch broad');
    const added = plot.panels.map((data, k) => addPanel(box, plot, data, k === plot.panels.length - 1, extent));
    const acts = [['−', 'zoom out', '-', 1.6, 0], ['+', 'zoom in', '+', 1 / 1.6, 0], ['‹', 'earlier', 'ArrowLeft', 1, -0.25],
      ['›', 'later', 'ArrowRight', 1, 0.25], ['all', 'show all', 'Home', Infinity, 0]];
    for (const [sign, title, , ...how] of acts) button(tools, sign, title, () => move(added[0], ...how));
    box.tabIndex = 0;
    box.addEventListener('keydown', (event) => {
      const act = event.target === box && acts.find(([, , key]) => key === event.key);
      if (!act) return;
      event.preventDefault();
      move(added[0], ...act.slice(3));
    });
    box.panels = added;
    box.charts = added.map(({ chart }) => chart);
    const fit = () => box.charts.forEach((chart) => {
      const width = box.clientWidth;
      if (width && chart.width !== width) chart.setSize({ width, height: chart.height });
    });
    new ResizeObserver(fit).observe(box);
  }

  // Returns the state after one classic Runge-Kutta step of h [s], as in rollout.py.
  function advance(p, x, t1, t2, h) {
    const rate = (y) => [y[2], y[3], ...acceleration(p, ...y, t1, t2)];
    const after = (time, slope) => x.map((each, j) => each + time * slope[j]);
    const k1 = rate(x), k2 = rate(after(h / 2, k1)), k3 = rate(after(h / 2, k2)), k4 = rate(after(h, k3));
    return x.map((each, j) => each + h / 6 * (k1[j] + 2 * (k2[j] + k3[j]) + k4[j]));
  }
  // Returns the states of some steps from x on; substeps resolve stiff friction.
  function simulate(p, x, [tau1, tau2], h, substeps, first, steps) {
    const states = [x];
    for (let k = first; k < first + steps; k += 1) {
      for (let part = 0; part < substeps; part += 1) x = advance(p, x, tau1[k], tau2[k], h / substeps);
      states.push(x);
    }
    return states;
  }

  // Returns the measured motion of a plot, and its simulation, restarted after `every` steps.
  function addSimulation(plot) {
    const { first, step, substeps, states, tau, scale, every } = plot.live, last = states[0].length - 1;
    const t = states[0].map((_, k) => first + k * step);
    const errors = plot.panels.slice(4).flatMap(({ lines }) => lines);
    for (const panel of plot.panels) {
      panel.t = t;
      for (const line of panel.lines) line.y = t.map(() => null);
    }
    states.forEach((state, j) => { plot.panels[j].lines[0].y = state; });
    const drawn = states.map((_, j) => {
      const { lines: [, simulated, dots], reach: [low, high] } = plot.panels[j];
      return { simulated, dots, error: errors[j], far: 20 * (high - low) };
    });
    const measured = t.map((_, k) => states.map((state) => state[k]));
    const live = { t, step, tau, measured, simulated: [], p: [...rig.vectors.identified], fit: [] };
    live.update = () => {
      for (const { lines } of plot.panels) for (const { label, y } of lines) if (label !== 'measured') y.fill(null);
      live.simulated = [];
      const squares = [0, 0, 0, 0];
      for (let begin = 0; begin < last; begin += every) {
        const steps = Math.min(every, last - begin);
        const shown = begin + steps < last ? steps - 2 : steps; // a gap before the next simulation
        simulate(live.p, measured[begin], tau, step, substeps, begin, steps).forEach((x, k) => {
          if (x.every(Number.isFinite)) live.simulated[begin + k] = x;
          drawn.forEach(({ simulated, dots, error, far }, j) => {
            const deviation = x[j] - states[j][begin + k], square = deviation * deviation;
            if (!k) dots.y[begin] = x[j];
            else squares[j] += square < 1e6 ? square : 1e6;
            if (k > shown || !(Math.abs(deviation) < far)) return;
            simulated.y[begin + k] = x[j];
            error.y[begin + k] = deviation;
          });
        });
      }
      live.fit = squares.map((sum, j) => 100 * (1 - Math.sqrt(sum / last) / scale[j]));
    };
    live.update();
    return live;
  }

  // Returns a function that draws the rig at a time: both poses, the tips' traces of the last half second, the torque.
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
        const q = pose(states, t), [group] = find(`g.${name}`), [trace] = find(`.trace.${name}`);
        group.style.display = q ? '' : 'none';
        const [x, y, ...tip] = joints(q ?? [0, 0]);
        group.firstElementChild.setAttribute('points', `0,0 ${x},${y} ${tip}`);
        group.lastElementChild.setAttribute('cx', x);
        group.lastElementChild.setAttribute('cy', y);
        const before = Array.from({ length: 26 }, (_, k) => pose(states, t - 0.02 * k)).filter(Boolean);
        trace.setAttribute('points', before.map((each) => joints(each).slice(2)).join(' '));
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

  function addPlayer(player, live, chart) {
    const [play, scrub, clock] = player.children;
    play.addEventListener('click', () => (before === null ? run() : stop()));
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
      const t = now + (time - before) / 1000;
      before = time;
      show(Math.min(t, last));
      if (t >= last) stop(); else requestAnimationFrame(step);
    };
    const run = () => {
      if (now >= last - 0.01) now = first;
      play.textContent = '❚❚ stop';
      before = performance.now();
      requestAnimationFrame(step);
    };
    scrub.addEventListener('input', () => { stop(); show(Number(scrub.value)); });
    animate(first);
    if (!matchMedia('(prefers-reduced-motion: reduce)').matches) run();
    return () => animate(now);
  }

  // Updates the slider of each parameter, within its interval or beyond, and simulates again after each change.
  function addSliders(box, live, refresh) {
    const { names, vectors, intervals } = rig, find = (selector) => box.querySelector(selector), wide = find('[type=checkbox]');
    const hint = 'Each slider moves one parameter within its 95 % interval. Correlated parameters only fit together.';
    const update = () => {
      for (const each of box.querySelectorAll('.slider')) {
        const k = names.indexOf(each.dataset.name), [low, high] = intervals[each.dataset.name];
        const middle = vectors.identified[k], reach = Math.max(5 * (high - low), Math.abs(middle));
        const [min, max] = wide.checked ? [middle - reach, middle + reach] : [low, high];
        if (!wide.checked) live.p[k] = Math.min(Math.max(live.p[k], low), high);
        Object.assign(each.querySelector('input'), { min, max, value: live.p[k] });
        each.querySelector('output').textContent = signed(live.p[k].toPrecision(4));
      }
      const [P1, P2, P3] = live.p, physical = P1 > 0 && P2 > 0 && P1 * P2 > P3 * P3;
      const text = physical ? hint : 'No rig can have these parameters: M(q) is not positive definite.';
      if (find('[role=status]').textContent !== text) find('[role=status]').textContent = text;
      refresh();
    };
    let waiting = 0;
    box.addEventListener('input', ({ target }) => {
      const { name } = target.parentElement.dataset;
      if (name) live.p[names.indexOf(name)] = Number(target.value);
      cancelAnimationFrame(waiting);
      waiting = requestAnimationFrame(update);
    });
    for (const each of box.querySelectorAll('[data-vector]')) {
      each.addEventListener('click', () => {
        const { vector } = each.dataset;
        wide.checked ||= vector !== 'identified';
        live.p = [...vectors[vector]];
        update();
      });
    }
    update();
  }

  const boxes = [...document.querySelectorAll('[data-plot]')];
  const live = plots.simulation?.live && rig ? addSimulation(plots.simulation) : null;
  for (const box of boxes) addPlot(box, plots[box.dataset.plot]);
  if (live) {
    const box = boxes.find((each) => each.dataset.plot === 'simulation');
    let pose = () => {};
    const refresh = () => {
      live.update();
      box.panels.forEach(({ chart, table, fit }, k) => {
        const { min, max } = chart.scales.x;
        chart.setData(table(), !Number.isFinite(min));
        if (Number.isFinite(min)) chart.setScale('x', { min, max });
        if (k < 4) fit.textContent = `fit ${live.fit[k] > -1000 ? signed(live.fit[k].toFixed(1)) : '—'} %`;
      });
      pose();
    };
    pose = addPlayer(document.querySelector('.player'), live, box.charts[0]);
    addSliders(document.querySelector('.controls'), live, refresh);
    window.pendubot = { live };
  }
  for (const each of document.querySelectorAll('[data-copy]')) {
    each.addEventListener('click', async () => {
      await navigator.clipboard.writeText(each.dataset.copy);
      each.textContent = 'copied';
    });
  }
})();
