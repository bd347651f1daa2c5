"""How the report looks: light or dark as the reader has it, on a phone, a wide screen and paper."""

STYLE = """
:root { color-scheme: light dark; --ink: #20242a; --soft: #5b6470; --ground: #fbfbfa; --card: #f1f2f3;
  --rule: #d4d8dd; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; max-width: min(1680px, 94vw); margin: 2em auto;
  padding: 0 1em; color: var(--ink); background: var(--ground); overflow-wrap: break-word; }
h1 { font-size: 1.7em; line-height: 1.2; margin: 0 0 0.2em; }
h2 { font-size: 1.25em; margin: 2.2em 0 0.5em; padding-bottom: 0.2em; border-bottom: 1px solid var(--rule); }
h3 { font-size: 1.1em; margin: 0 0 0.3em; }
p, li { max-width: 58em; margin: 0.35em 0; }
.source { color: var(--soft); max-width: none; }
.verdict { margin: 1.2em 0; padding: 1em 1.3em; border-left: 8px solid; border-radius: 6px; background: var(--card); }
.verdict h2 { margin: 0 0 0.3em; padding: 0; border: 0; }
.verdict h3 { margin-top: 0.9em; font-size: 1em; }
.good { border-color: #2a9d4e; } .care { border-color: #e0a020; } .not { border-color: #d03030; }
ul { margin: 0.2em 0; padding-left: 1.3em; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 380px), 1fr)); gap: 1.4em;
  align-items: start; }
.camera { margin: 1.2em 0; padding: 1em 1.2em; border: 1px solid var(--rule); border-radius: 6px; }
.parts, .tables { display: flex; flex-wrap: wrap; gap: 0.6em 1.3em; align-items: flex-start; }
.parts > figure { flex: 1 1 320px; } .tables table { font-size: 0.86em; margin: 0.2em 0; }
figure { margin: 0; max-width: 640px; } figcaption { font-size: 0.88em; color: var(--soft); }
svg { display: block; width: 100%; height: auto; fill: currentColor; }
svg text { font: 10px system-ui, "DejaVu Sans", sans-serif; }
.name { paint-order: stroke; stroke: var(--ground); stroke-width: 3px; stroke-linejoin: round; }
table { border-collapse: collapse; margin: 0.5em 0 1em; font-variant-numeric: tabular-nums; }
td, th { padding: 0.25em 0 0.25em 1.4em; text-align: right; vertical-align: bottom; white-space: pre; }
td:first-child, th:first-child { padding-left: 0; } .words { text-align: left; }
th { font-weight: 600; border-bottom: 1px solid var(--rule); line-height: 1.25; }
th small { font-weight: 400; color: var(--soft); }
tbody tr + tr td { border-top: 1px solid color-mix(in srgb, var(--rule) 50%, transparent); }
pre { font-size: 0.85em; white-space: pre-wrap; padding: 1em; border-radius: 6px; background: var(--card); }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #dfe2e6; --soft: #9aa3ae; --ground: #15171b; --card: #1e2126; --rule: #353a42; }
}
@media screen and (max-width: 760px) {
  body { padding: 0 0.4em; }
  .verdict, .camera { padding: 0.8em; }
  .rows thead { display: none; }
  .rows, .rows tbody, .rows tr, .rows td { display: block; }
  .rows tr { padding: 0.4em 0; border-top: 1px solid var(--rule); }
  .rows td { display: flex; justify-content: space-between; gap: 1em; padding: 0.1em 0; border: 0 !important; }
  .rows td:first-child { font-weight: 600; justify-content: start; }
  .rows td:empty { display: none; }
  .rows td:not(:first-child)::before { content: attr(data-label); color: var(--soft); }
}
@media print {
  body { font-size: 9.5pt; margin: 0; max-width: none; padding: 0; background: none; }
  .row { grid-template-columns: 1fr 1fr; gap: 0.8em; }
  .tables { flex: 1 1 100%; } .parts > figure { flex: 0 1 47%; } .rows { font-size: 7.6pt; }
  h2, h3, h2 + p { break-after: avoid; } figure, tr, .verdict, .camera { break-inside: avoid; }
  td, th { padding-left: 0.8em; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""
