import ast,sys,collections
from pathlib import Path
root=Path(sys.argv[1])
mods={}
for base,pre in((root/'cbsr_qa','cbsr_qa'),(root/'plugins/cbsr_qa_plugins','cbsr_qa_plugins'),(root/'migrations','cbsr_qa._migrations'),(root/'reports','cbsr_qa._reports'),(root/'stations','cbsr_qa._stations')):
    for p in base.rglob('*.py'):
        r=p.relative_to(base).with_suffix('')
        parts=[pre,*r.parts]
        if parts[-1]=='__init__': parts=parts[:-1]
        mods['.'.join(parts)]=p
imps=collections.defaultdict(set)
for m,p in mods.items():
    t=ast.parse(p.read_text())
    for n in ast.walk(t):
        if isinstance(n,ast.ImportFrom) and n.module and n.level==0:
            for a in n.names:
                f=n.module+'.'+a.name
                if f in mods: imps[m].add(f)
                elif n.module in mods: imps[m].add(n.module)
        elif isinstance(n,ast.Import):
            for a in n.names:
                if a.name in mods: imps[m].add(a.name)
        elif isinstance(n,ast.Constant) and isinstance(n.value,str) and ':' in n.value and n.value.split(':')[0] in mods:
            imps[m].add(n.value.split(':')[0])
users=collections.defaultdict(set)
for m,s in imps.items():
    for x in s:
        if x!=m: users[x].add(m)
if __name__=='__main__':
    pk=sys.argv[2] if len(sys.argv)>2 else ''
    for m in sorted(mods):
        if not m.startswith(pk): continue
        p=mods[m]; t=ast.parse(p.read_text()); d=(ast.get_docstring(t) or '').split('\n')[0]
        u=users[m]
        su=', '.join(sorted(x.replace('cbsr_qa.','').replace('cbsr_qa_plugins','P') for x in u)) if len(u)<=3 else f"{len(u)}: "+','.join(sorted({'.'.join(x.replace('cbsr_qa_plugins','P').replace('cbsr_qa.','').split('.')[:1 if not x.startswith('cbsr_qa_plugins') else 2]) for x in u}))
        print(f"{m.replace('cbsr_qa.','')} {len(p.read_text().splitlines())} | {d[:90]} | <- {su}")
