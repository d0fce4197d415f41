"""Writes doors (lazy, by stub) and has everybody outside import from them. usage: make_doors.py REPO"""
import ast,sys,collections,re
from pathlib import Path
repo=Path(sys.argv[1]).resolve()
sys.argv=['x',str(repo)]
ROOTS={'cbsr_qa':repo/'cbsr_qa','cbsr_qa_plugins':repo/'plugins/cbsr_qa_plugins'}
mods={};pks={}
for r,b in ROOTS.items():
    for p in b.rglob('*.py'):
        parts=[r,*p.relative_to(b).with_suffix('').parts]
        if parts[-1]=='__init__': pks['.'.join(parts[:-1])]=p
        else: mods['.'.join(parts)]=p
class Lines:
    def __init__(self,text):
        self.starts=[0]; self.raw=text.splitlines(keepends=True)
        for l in self.raw: self.starts.append(self.starts[-1]+len(l))
    def pos(self,line,col): return self.starts[line-1]+len(self.raw[line-1].encode()[:col].decode())
offers=collections.defaultdict(lambda: collections.defaultdict(set))
def render(module,names,indent):
    words=sorted({n if not a or a==n else f'{n} as {a}' for n,a in names})
    return f"from {module} import {', '.join(words)}"
SAME={('cbsr_qa.calibration.fits.steady_state','learn_kernel'):'cbsr_qa.calibration.fits.relaxation_kernel'}
SKIP={'cbsr_qa.cli.studies'}
def process(text,home,is_test=False):
    """home: dotted package of the importer, or '' for outsiders (tests, docs)."""
    try: tree=ast.parse(text)
    except SyntaxError: return text
    L=Lines(text); edits=[]
    for n in ast.walk(tree):
        if isinstance(n,ast.ImportFrom) and n.level==0 and n.module in mods and n.module.startswith('cbsr_qa.'):
            door=n.module.rsplit('.',1)[0]
            inside=home==door or home.startswith(door+'.')
            if inside or door=='cbsr_qa': continue
            private=[a.name for a in n.names if a.name.startswith('_')]
            if private: continue
            if door in SKIP: continue
            for a in n.names: offers[door][a.name].add(SAME.get((n.module,a.name),n.module))
            edits.append((L.pos(n.lineno,n.col_offset),L.pos(n.end_lineno,n.end_col_offset),render(door,[(a.name,a.asname) for a in n.names],'')))
    for s,e,new in sorted(edits,reverse=True): text=text[:s]+new+text[e:]
    return text
todo=[]
for m,p in mods.items(): todo.append((p,m.rsplit('.',1)[0]))
for p in sorted(repo.glob('benchmarks/**/*.py')): todo.append((p,''))
for p in sorted(repo.glob('tests/**/*.py')):
    # a test may import inside the package that it mirrors
    rel=p.parent.relative_to(repo/'tests').parts
    home=''
    if rel and rel[0]=='plugins': home='.'.join(('cbsr_qa_plugins',*rel[1:]))
    elif rel: home='.'.join(('cbsr_qa',*rel))
    todo.append((p,home))
for p in sorted((repo/'docs').rglob('*.py')): todo.append((p,''))
new={}
for p,home in todo:
    t=p.read_text(); u=process(t,home)
    if u!=t: new[p]=u
for p in [repo/'README.md',*sorted((repo/'docs').rglob('*.md'))]:
    t=p.read_text(); u=re.sub(r'(?ms)^(```python\n)(.*?)(^```)',lambda m:m[1]+process(m[2],'')+m[3],t)
    if u!=t: new[p]=u
bad=False
for d,o in offers.items():
    for name,ms in o.items():
        if len(ms)>1: print('COLLISION',d,name,ms); bad=True
if bad: sys.exit(1)
for p,u in new.items(): p.write_text(u)
docs={}
for l in open(Path(__file__).with_name('doors.txt')):
    k,v=l.rstrip('\n').split(': ',1); docs['cbsr_qa.'+k]=v
for pk,p in pks.items():
    if not pk.startswith('cbsr_qa.'): continue
    o=offers.get(pk,{})
    doc=docs.get(pk) or print('NO DOC',pk) or pk
    if not o:
        p.write_text(f'"""{doc}"""\n'); continue
    p.write_text(f'"""{doc}"""\n\nimport lazy_loader\n\n__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)\n')
    by=collections.defaultdict(list)
    for name,ms in o.items(): by[next(iter(ms))].append(name)
    lines=[]
    for m in sorted(by):
        leaf=m[len(pk)+1:]
        names=sorted(by[m])
        one=f"from .{leaf} import "+', '.join(f'{n} as {n}' for n in names)
        lines.append(one if len(one)<=118 else f"from .{leaf} import (\n"+''.join(f'    {n} as {n},\n' for n in names)+')')
    p.with_suffix('.pyi').write_text('\n'.join(lines)+'\n')
print({d.removeprefix('cbsr_qa.'):len(o) for d,o in sorted(offers.items(),key=lambda x:-len(x[1]))})
