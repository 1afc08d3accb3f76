"""The look of the report: one style sheet, no fonts or pictures from elsewhere, the same on paper."""

STYLE = """
:root{--ink:#22262b;--soft:#5d6670;--line:#dfe3e7;--paper:#fcfcfb;--card:#fff;--accent:#2c6e8f;--alarm:#b3261e;
--amber:#8a5a00}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--paper);color:var(--ink);line-height:1.55;
font-family:system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,"Liberation Sans",sans-serif;
font-size:16px;font-variant-numeric:tabular-nums;overflow-wrap:anywhere}
main{max-width:1100px;margin:0 auto;padding:40px 24px 64px}
h1{font-size:2.1rem;line-height:1.2;font-weight:600;letter-spacing:-.01em;margin:0 0 .15em;unicode-bidi:isolate}
h2{font-size:1.25rem;font-weight:600;margin:0 0 .5rem}
h3{font-size:1rem;font-weight:600;margin:0}
p{margin:0 0 .8rem;max-width:72ch}
section{margin-top:44px;padding-top:22px;border-top:1px solid var(--line)}
.kicker{color:var(--soft);margin:0 0 1.4rem}
nav{margin:1.2rem 0 0;font-size:.9rem;color:var(--soft)}
nav a{color:var(--accent);text-decoration:none;margin-right:1.1em;white-space:nowrap}
nav a:hover,nav a:focus{text-decoration:underline}
dl.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(138px,1fr));margin:0;
background:var(--card);border:1px solid var(--line);border-radius:8px;overflow:hidden}
dl.figures div{outline:1px solid var(--line);outline-offset:-.5px;padding:12px 14px;display:flex;flex-direction:column}
dl.figures dt{order:2;color:var(--soft);font-size:.82rem;line-height:1.35}
dl.figures dd{margin:0;font-size:1.2rem;font-weight:600;line-height:1.4;white-space:nowrap}
.advice{margin-top:22px;border:1px solid var(--line);border-left:4px solid var(--amber);border-radius:8px;
background:var(--card);padding:16px 20px 8px}
.advice.fine{border-left-color:#3c7a4b}
.advice h2{font-size:1.05rem;margin-bottom:.4rem}
.advice ul{margin:0 0 .6rem;padding-left:1.15em}
.advice li{margin-bottom:.45rem;max-width:84ch}
.advice .consider{color:var(--soft)}
figure{margin:0;break-inside:avoid}
figcaption,caption{color:var(--soft);font-size:.87rem;line-height:1.45;text-align:left}
figcaption{margin-top:.45rem}
figcaption strong{color:var(--ink);font-weight:600}
img{display:block;width:100%;height:auto;border-radius:4px;background:#eee}
.faces{display:grid;grid-template-columns:repeat(auto-fit,minmax(220px,1fr));gap:22px}
.over{position:relative}
.over svg{position:absolute;inset:0;width:100%;height:100%}
.over path{fill:none;stroke-width:1.1;vector-effect:none}
.over .halo{stroke:#000;stroke-opacity:.45;stroke-width:2.2}
.over .mask{stroke:#fff}
.over .rigid{stroke:#7fd4ff;stroke-dasharray:4 2.5}.over .mouth{stroke:#ffd36b;stroke-dasharray:1.5 2}
.over circle{fill:#fff;stroke:#000;stroke-opacity:.6;stroke-width:.6}
.sheet{display:grid;grid-template-columns:repeat(8,1fr);gap:14px 10px}
.sheet figcaption{font-size:.74rem;margin-top:.25rem;line-height:1.3}
.component{display:grid;grid-template-columns:170px 1fr;gap:18px;align-items:center;padding:12px 0;
border-top:1px solid var(--line);break-inside:avoid}
.component:first-of-type{border-top:0}
.component p{font-size:.85rem;color:var(--soft);margin:.25rem 0 0;line-height:1.45}
.strip{display:grid;grid-template-columns:repeat(6,1fr);gap:6px}
.strip figcaption{text-align:center;font-size:.78rem;margin-top:.2rem}
.maps{display:grid;grid-template-columns:repeat(auto-fill,minmax(230px,1fr));gap:20px;margin-top:1rem}
.maps img{image-rendering:pixelated}
.pair{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(420px,100%),1fr));gap:22px 20px;margin-top:1rem}
.plot{overflow-x:auto}.plot svg{display:block;width:100%;min-width:640px;height:auto}
.plot.narrow svg{min-width:300px}
svg text{font-size:12px;fill:var(--soft);font-family:inherit}
svg .axis{fill:var(--ink)}svg .name{fill:var(--ink);font-weight:600}svg .level-words{fill:var(--accent)}
svg .name,svg .level-words{paint-order:stroke;stroke:var(--paper);stroke-width:4px;stroke-linejoin:round}
svg .grid{stroke:var(--line);fill:none}
svg .series{stroke:var(--accent);fill:none;stroke-width:1.6;stroke-linejoin:round}
svg .area{fill:var(--accent);fill-opacity:.09}
svg .point{fill:var(--accent)}svg .dot{fill:var(--accent);stroke:#fff;stroke-width:1.5}
svg .worst{fill:var(--alarm);stroke:#fff}svg .leader{stroke:var(--soft);stroke-width:.8;fill:none}
svg .level{stroke:var(--accent);stroke-dasharray:5 4;fill:none}
.wide{overflow-x:auto;margin-top:1rem}
table{border-collapse:collapse;width:100%;font-size:.9rem}
caption{padding-bottom:.5rem}
th,td{padding:6px 14px 6px 0;text-align:left;vertical-align:top;border-top:1px solid var(--line);
unicode-bidi:isolate;overflow-wrap:break-word}
thead th{border-top:0;border-bottom:1px solid var(--soft);font-weight:600;color:var(--soft);font-size:.82rem}
tbody th{font-weight:500}
tr.chosen>*{font-weight:600}
table.few{max-width:560px}
table.pairs td{overflow-wrap:anywhere}table.pairs tbody th{width:30%;color:var(--soft);font-weight:400}
details{margin-top:1rem}td details{margin:0}summary{cursor:pointer;color:var(--accent)}
code{font-family:ui-monospace,SFMono-Regular,Menlo,Consolas,"Liberation Mono",monospace;font-size:.86em}
footer{margin-top:48px;padding-top:14px;border-top:1px solid var(--line);color:var(--soft);font-size:.85rem}
@media (max-width:820px){.sheet{grid-template-columns:repeat(4,1fr)}.component{grid-template-columns:1fr;gap:8px}
main{padding:24px 14px 40px}}
@media print{@page{margin:14mm}body{background:#fff;font-size:10.5pt;print-color-adjust:exact;
-webkit-print-color-adjust:exact}main{padding:0;max-width:none}nav{display:none}section{margin-top:24px;padding-top:14px}
h2{break-after:avoid}.plot svg{min-width:0}.sheet{grid-template-columns:repeat(8,1fr)}
.component{grid-template-columns:120px 1fr}tr{break-inside:avoid}
.pair{grid-template-columns:1fr 1fr}.plot.narrow svg{min-width:0}dl.figures{grid-template-columns:repeat(7,1fr)}
dl.figures dd{font-size:1rem}dl.figures div{padding:8px 9px}table{font-size:9pt}th,td{padding-right:8px}}
"""
