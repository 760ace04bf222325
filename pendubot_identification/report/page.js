// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0

// Makes the plots over time of a report explorable, and animates the rig. The data are in the JSON block "plots", made
// by time_plot.py. All plots share one time axis: what one shows, all others show, unless they have nothing there.
'use strict';
(() => {
  const plots = JSON.parse(document.getElementById('plots').textContent);
  const panels = [];
  const GUTTER = 54, INK = '#1a1a1a', PALE = '#dddddd', FONT = '11px system-ui, sans-serif';
  let animate = () => {};
  const element = (tag, parent, text = '', name = '') => {
    const made = document.createElement(tag);
    made.textContent = text;
    made.className = name;
    parent.append(made);
    return made;
  };
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
    const next = line.t.findIndex((at) => at > t);
    if (next === 0 || (next < 0 && !(line.t.at(-1) >= t))) return null;
    const [k, n] = next < 0 ? [line.t.length - 1, line.t.length - 1] : [next - 1, next];
    const [a, b] = [line.y[k], line.y[n]];
    if (a === null || line.style === 'steps' || k === n) return a;
    return b === null ? null : a + (b - a) * (t - line.t[k]) / (line.t[n] - line.t[k]);
  }

  // Writes the values at a time above each panel, and poses the rig.
  function read(panel, t) {
    for (const [line, output] of panel.outputs) {
      const at = t === null ? null : value(line, t);
      output.textContent = at === null ? '' : at.toPrecision(4).replace('-', '−');
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
    element('i', item, '', name).style.background = colour;
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
    const head = element('div', box, '', 'head');
    element('b', head, data.label);
    const panel = { extent };
    panel.outputs = data.lines.filter((line) => line.style !== 'dots').map((line) => [
      line, element('output', legend(head, line.colour, line.label)),
    ]);
    const tables = [], lines = [{}], bands = [];
    for (const line of data.lines) {
      tables.push(line.upper ? [line.t, line.y, line.upper] : [line.t, line.y]);
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
        { ...tick, size: GUTTER, space: 26, values: (chart, ticks) => ticks.map((y) => String(+y.toPrecision(6)).replace('-', '−')) }],
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
    }, uPlot.join(tables), box);
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
    const tools = element('div', box, '', 'tools');
    const times = plot.panels.flatMap((panel) => panel.lines.flatMap((line) => [line.t[0], line.t.at(-1)])).filter(isFinite);
    const extent = [Math.min(...times), Math.max(...times)];
    const kinds = new Map(plot.spans.filter(([, , , label]) => label).map(([, , colour, label]) => [label, colour]));
    for (const [label, colour] of kinds) legend(tools, colour + '66', label, 'swatch broad');
    const own = plot.panels.map((data, k) => addPanel(box, plot, data, k === plot.panels.length - 1, extent));
    const quarter = () => (shown(own[0])[1] - shown(own[0])[0]) / 4;
    const acts = [
      ['−', 'zoom out', '-', () => widen(own[0], 1.6)], ['+', 'zoom in', '+', () => widen(own[0], 1 / 1.6)],
      ['‹', 'earlier', 'ArrowLeft', () => shift(own[0], -quarter())], ['›', 'later', 'ArrowRight', () => shift(own[0], quarter())],
      ['all', 'show all', 'Home', () => zoom(null)],
    ];
    for (const [sign, title, , act] of acts) {
      const button = element('button', tools, sign);
      button.type = 'button';
      button.title = button.ariaLabel = title;
      button.addEventListener('click', act);
    }
    box.tabIndex = 0;
    box.addEventListener('keydown', (event) => {
      const found = event.target === box && acts.find(([, , key]) => key === event.key);
      if (found) { event.preventDefault(); found[3](); }
    });
    box.charts = own.map(({ chart }) => chart);
    box.fit = (width) => box.charts.forEach((chart) => {
      if (width && chart.width !== width) chart.setSize({ width, height: chart.height });
    });
    new ResizeObserver(() => box.fit(box.clientWidth)).observe(box);
  }

  // The rig: angle of link 1 from the horizontal, of link 2 relative to it, both links drawn equally long.
  function addRig(box, plot, chart) {
    const canvas = element('canvas', box), ctx = canvas.getContext('2d');
    const tools = element('div', box, '', 'tools');
    const play = element('button', tools, '▶ play'), clock = element('output', tools), speed = element('select', tools);
    const scrub = element('input', box);
    const lines = ['measured', 'simulated'].map((label) => plot.panels.slice(0, 2).map((p) => p.lines.find((l) => l.label === label)));
    const first = Math.max(lines[0][0].t[0], lines[1][0].t[0]), last = Math.min(lines[0][0].t.at(-1), lines[1][0].t.at(-1));
    play.type = 'button';
    for (const part of [1, 0.5, 0.2]) element('option', speed, `× ${part}`).value = part;
    speed.ariaLabel = 'speed';
    Object.assign(scrub, { type: 'range', min: first, max: last, step: 'any', value: first, ariaLabel: 'time' });
    canvas.width = canvas.height = 544;
    const link = (q, colour, width) => {
      if (q.includes(null)) return;
      const reach = canvas.width / 4.4, centre = canvas.width / 2;
      const x = centre + reach * Math.cos(q[0]), y = centre - reach * Math.sin(q[0]);
      Object.assign(ctx, { strokeStyle: colour, fillStyle: colour, lineWidth: width, lineCap: 'round', lineJoin: 'round' });
      ctx.beginPath();
      ctx.moveTo(centre, centre);
      ctx.lineTo(x, y);
      ctx.lineTo(x + reach * Math.cos(q[0] + q[1]), y - reach * Math.sin(q[0] + q[1]));
      ctx.stroke();
      ctx.beginPath();
      ctx.arc(x, y, width, 0, 7);
      ctx.fill();
    };
    animate = (at) => {
      const t = Math.min(Math.max(at, first), last);
      scrub.value = t;
      clock.textContent = `${t.toFixed(2)} s`;
      ctx.clearRect(0, 0, canvas.width, canvas.height);
      const poses = lines.map((pose) => pose.map((line) => value(line, t)));
      link(poses[0], INK, 14);
      link(poses[1], '#d55e00', 5);
      canvas.dataset.poses = JSON.stringify(poses);
    };
    function show(t) {
      chart.setCursor({ left: chart.valToPos(t, 'x'), top: 0 }, true, true);
      animate(t);
    }
    let before = null;
    function stop() { before = null; play.textContent = '▶ play'; }
    function step(now) {
      if (before === null) return;
      const t = Number(scrub.value) + (now - before) / 1000 * speed.value;
      before = now;
      show(Math.min(t, last));
      if (t >= last) stop(); else requestAnimationFrame(step);
    }
    play.addEventListener('click', () => {
      if (before !== null) { stop(); return; }
      if (Number(scrub.value) >= last) scrub.value = first;
      play.textContent = '❚❚ stop';
      before = performance.now();
      requestAnimationFrame(step);
    });
    scrub.addEventListener('input', () => { stop(); show(Number(scrub.value)); });
    animate(first);
  }

  const boxes = [...document.querySelectorAll('[data-plot]')];
  for (const box of boxes) addPlot(box, plots[box.dataset.plot]);
  for (const box of document.querySelectorAll('[data-rig]')) {
    addRig(box, plots[box.dataset.rig], boxes.find((other) => other.dataset.plot === box.dataset.rig).charts[0]);
  }

  // On paper nothing is folded, and plots are as wide as the paper.
  const folded = [];
  addEventListener('beforeprint', () => {
    folded.push(...document.querySelectorAll('details:not([open])'));
    folded.forEach((each) => { each.open = true; });
    boxes.forEach((box) => box.fit(680));
  });
  addEventListener('afterprint', () => {
    folded.splice(0).forEach((each) => { each.open = false; });
    boxes.forEach((box) => box.fit(box.clientWidth));
  });
})();
