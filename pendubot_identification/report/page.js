// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0

// Makes the plots over time of a report explorable, and moves the rig. All that it shows is in the JSON block "plots",
// made by time_plot.py; where this does not run, the static figures stand.
'use strict';
(() => {
  const plots = JSON.parse(document.getElementById('plots').textContent);
  const axes = {}; // by name: all panels that share a time axis
  const GUTTER = 54, INK = '#1a1a1a', PALE = '#dddddd', FONT = '11px system-ui, sans-serif';
  const element = (tag, parent, text = '', name = '') => {
    const made = document.createElement(tag);
    made.textContent = text;
    made.className = name;
    parent.append(made);
    return made;
  };
  document.documentElement.classList.add('scripted');

  // Time axes: what one panel shows, all others of its axis show, unless they have nothing there.
  function zoom(axis, low, high) {
    for (const panel of axes[axis]) {
      const [first, last] = panel.extent;
      const all = low === null;
      if (all || (low < last && high > first)) panel.chart.setScale('x', { min: all ? first : low, max: all ? last : high });
    }
  }
  const shown = (panel) => [panel.chart.scales.x.min, panel.chart.scales.x.max];
  function widen(panel, factor, about = null) {
    const [low, high] = shown(panel), [first, last] = panel.extent;
    const middle = about === null ? (low + high) / 2 : about;
    const least = 1e-3 * (last - first); // the data are thinned: nothing is to be seen nearer
    const [a, b] = [middle - (middle - low) * factor, middle + (high - middle) * factor];
    if (b - a >= last - first) zoom(panel.axis, null);
    else if (b - a > least) zoom(panel.axis, a, b);
  }
  function shift(panel, distance) {
    const [low, high] = shown(panel), [first, last] = panel.extent;
    const by = Math.max(Math.min(distance, last - high), first - low);
    zoom(panel.axis, low + by, high + by);
  }

  // The moment that is read: a line in every panel of the axis, the values above it, and the rig.
  const listeners = [];
  let telling = false;
  function moment(axis, t) {
    if (telling) return;
    telling = true;
    for (const panel of axes[axis]) {
      const [low, high] = shown(panel);
      const inside = t !== null && t >= low && t <= high;
      panel.chart.setCursor({ left: inside ? panel.chart.valToPos(t, 'x') : -10, top: inside ? 0 : -10 });
      panel.read(t);
    }
    for (const listen of listeners) if (t !== null && listen.axis === axis) listen.at(t);
    telling = false;
  }

  // The value of a line at a time, between its points; null outside and in its gaps.
  function value(line, t) {
    let low = 0, high = line.t.length - 1;
    if (high < 0 || !(t >= line.t[0] && t <= line.t[high])) return null;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (line.t[middle] <= t) low = middle; else high = middle;
    }
    const [a, b] = [line.y[low], line.y[high]];
    if (a === null || line.style === 'steps' || low === high) return a;
    return b === null ? null : a + (b - a) * (t - line.t[low]) / (line.t[high] - line.t[low]);
  }

  function series(line) {
    const own = { stroke: line.colour, width: line.width, points: { show: false } };
    if (line.style === 'steps') own.paths = uPlot.paths.stepped({ align: 1 });
    if (line.style === 'dots') Object.assign(own, { paths: () => null, points: { show: true, size: 5, fill: line.colour } });
    if (line.style === 'band') own.width = 0;
    return own;
  }

  function legend(head, colour, label, name = 'swatch') {
    const item = element('span', head);
    element('i', item, '', name).style.background = colour;
    item.append(label);
    return item;
  }

  function addPanel(box, plot, data, last, extent) {
    const head = element('div', box, '', 'head');
    element('b', head, data.label);
    const outputs = data.lines.filter((line) => line.style !== 'dots').map((line) => [
      line, element('output', legend(head, line.colour, line.label)),
    ]);
    const tables = [], lines = [{}], bands = [];
    for (const line of data.lines) {
      tables.push(line.upper ? [line.t, line.y, line.upper] : [line.t, line.y]);
      lines.push(series(line));
      if (line.upper) {
        lines.push({ ...series(line) });
        bands.push({ series: [lines.length - 1, lines.length - 2], fill: line.colour + '40' });
      }
    }
    const panel = { axis: plot.axis, extent };
    const within = (chart, low, high) => {
      const [least, most] = data.reach || [-Infinity, Infinity];
      if (low === null || low === undefined) return data.reach || [-1, 1];
      const space = 0.05 * (high - low) || Math.abs(high) || 1;
      return [Math.max(low - space, least), Math.min(high + space, most)];
    };
    const paint = (chart, draw) => {
      const { ctx, bbox } = chart, place = (t) => chart.valToPos(t, 'x', true);
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      draw(ctx, bbox, place);
      ctx.restore();
    };
    const tick = { stroke: INK, font: FONT, grid: { stroke: PALE, width: 1 }, ticks: { show: false } };
    panel.chart = new uPlot({
      width: Math.max(box.clientWidth, 200), height: last ? 138 : 104, legend: { show: false }, bands, series: lines,
      padding: [4, 10, last ? 0 : 4, 0],
      scales: { x: { time: false, min: extent[0], max: extent[1] }, y: { range: within } },
      axes: [last ? { ...tick, label: 'time [s]', labelFont: FONT, labelSize: 16, size: 24 } : { ...tick, size: 0, values: () => [] },
        { ...tick, size: GUTTER, space: 26, values: (chart, ticks) => ticks.map((y) => String(+y.toPrecision(6)).replace('-', '−')) }],
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false },
        bind: { dblclick: () => () => { zoom(plot.axis, null); return null; },
          mousedown: (chart, target, handle) => (event) => { if (!event.shiftKey) handle(event); return null; } } },
      hooks: {
        setSelect: [(chart) => {
          const { left, width } = chart.select;
          if (width > 3) zoom(plot.axis, chart.posToVal(left, 'x'), chart.posToVal(left + width, 'x'));
          chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
        setCursor: [(chart) => {
          if (!telling) moment(plot.axis, chart.cursor.left >= 0 ? chart.posToVal(chart.cursor.left, 'x') : null);
        }],
        drawClear: [(chart) => paint(chart, (ctx, bbox, place) => plot.spans.forEach(([begin, end, colour]) => {
          ctx.fillStyle = colour + '2e';
          ctx.fillRect(place(begin), bbox.top, place(end) - place(begin), bbox.height);
        }))],
        draw: [(chart) => paint(chart, (ctx, bbox, place) => plot.boundaries.forEach((begin, k) => {
          ctx.fillStyle = ctx.strokeStyle = '#777777';
          ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
          ctx.textAlign = 'left';
          ctx.setLineDash([4, 4]);
          ctx.beginPath();
          ctx.moveTo(place(begin), bbox.top);
          ctx.lineTo(place(begin), bbox.top + bbox.height);
          ctx.stroke();
          ctx.fillText(k + 1, place(begin) + 4, bbox.top + 12 * devicePixelRatio);
        }))],
      },
    }, uPlot.join(tables), box);
    panel.read = (t) => outputs.forEach(([line, output]) => {
      const at = t === null ? null : value(line, t);
      output.textContent = at === null ? '' : at.toPrecision(4).replace('-', '−');
    });
    (axes[plot.axis] = axes[plot.axis] || []).push(panel);

    const over = panel.chart.over;
    over.addEventListener('wheel', (event) => {
      if (!event.ctrlKey && !event.shiftKey) return; // the page scrolls
      event.preventDefault();
      const [low, high] = shown(panel), turned = event.deltaY || event.deltaX;
      if (event.shiftKey) shift(panel, Math.sign(turned) * (high - low) / 10);
      else widen(panel, turned > 0 ? 1.25 : 0.8, panel.chart.posToVal(event.offsetX, 'x'));
    }, { passive: false });
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
    const panels = plot.panels.map((data, k) => addPanel(box, plot, data, k === plot.panels.length - 1, extent));
    const quarter = () => (shown(panels[0])[1] - shown(panels[0])[0]) / 4;
    const acts = [
      ['−', 'zoom out', '-', () => widen(panels[0], 1.6)], ['+', 'zoom in', '+', () => widen(panels[0], 1 / 1.6)],
      ['‹', 'earlier', 'ArrowLeft', () => shift(panels[0], -quarter())], ['›', 'later', 'ArrowRight', () => shift(panels[0], quarter())],
      ['all', 'show all', 'Home', () => zoom(plot.axis, null)],
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
    new ResizeObserver(() => panels.forEach(({ chart }) => {
      if (box.clientWidth && chart.width !== box.clientWidth) chart.setSize({ width: box.clientWidth, height: chart.height });
    })).observe(box);
    box.charts = panels.map((panel) => panel.chart);
  }

  // The rig: angle of link 1 from the horizontal, of link 2 relative to it, both links drawn equally long.
  function addRig(box, plot) {
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
      ctx.strokeStyle = ctx.fillStyle = colour;
      ctx.lineWidth = width;
      ctx.lineCap = ctx.lineJoin = 'round';
      ctx.beginPath();
      ctx.moveTo(centre, centre);
      ctx.lineTo(x, y);
      ctx.lineTo(x + reach * Math.cos(q[0] + q[1]), y - reach * Math.sin(q[0] + q[1]));
      ctx.stroke();
      ctx.beginPath();
      ctx.arc(x, y, width, 0, 7);
      ctx.fill();
    };
    function at(t) {
      t = Math.min(Math.max(t, first), last);
      scrub.value = t;
      clock.textContent = `${t.toFixed(2)} s`;
      ctx.clearRect(0, 0, canvas.width, canvas.height);
      const poses = lines.map((pose) => pose.map((line) => value(line, t)));
      link(poses[0], '#1a1a1a', 14);
      link(poses[1], '#d55e00', 5);
      canvas.dataset.poses = JSON.stringify(poses);
    }
    let before = null;
    function step(now) {
      if (before === null) return;
      const t = Number(scrub.value) + (now - before) / 1000 * speed.value;
      before = now;
      moment(plot.axis, Math.min(t, last));
      if (t >= last) stop(); else requestAnimationFrame(step);
    }
    function stop() { before = null; play.textContent = '▶ play'; }
    play.addEventListener('click', () => {
      if (before !== null) { stop(); return; }
      if (Number(scrub.value) >= last) scrub.value = first;
      play.textContent = '❚❚ stop';
      before = performance.now();
      requestAnimationFrame(step);
    });
    scrub.addEventListener('input', () => { stop(); moment(plot.axis, Number(scrub.value)); });
    listeners.push({ axis: plot.axis, at });
    at(first);
  }

  for (const box of document.querySelectorAll('[data-plot]')) addPlot(box, plots[box.dataset.plot]);
  for (const box of document.querySelectorAll('[data-rig]')) addRig(box, plots[box.dataset.rig]);

  // On paper nothing is folded.
  const folded = [];
  addEventListener('beforeprint', () => {
    folded.push(...document.querySelectorAll('details:not([open])'));
    folded.forEach((each) => { each.open = true; });
  });
  addEventListener('afterprint', () => { folded.splice(0).forEach((each) => { each.open = false; }); });
})();
