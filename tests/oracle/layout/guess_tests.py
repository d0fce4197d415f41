import ast,sys,re,collections
from pathlib import Path
repo=Path(sys.argv[1])
ROOTS={'cbsr_qa':repo/'cbsr_qa','cbsr_qa_plugins':repo/'plugins/cbsr_qa_plugins'}
mods=set();pks=set()
for r,b in ROOTS.items():
    for p in b.rglob('*.py'):
        parts=[r,*p.relative_to(b).with_suffix('').parts]
        if parts[-1]=='__init__': pks.add('.'.join(parts[:-1]))
        else: mods.add('.'.join(parts))
base={'domain':.2,'testing':.3,'config':.5,'cli':.6,'plugin':.3,'system':.3}
for d in ('unit','numerics','recordings','properties'):
    for p in sorted((repo/'tests'/d).rglob('test_*.py')):
        t=ast.parse(p.read_text()); c=collections.Counter()
        words=set(p.stem.removeprefix('test_').split('_'))
        for n in ast.walk(t):
            ms=[]
            if isinstance(n,ast.ImportFrom) and n.module:
                if n.module in mods: ms=[n.module]*len(n.names)
                elif n.module in pks: ms=[n.module+'.'+a.name for a in n.names if n.module+'.'+a.name in mods]
            for m in ms:
                pk=m.rsplit('.',1)[0]; w=1
                for k,v in base.items():
                    if pk.startswith('cbsr_qa.'+k): w*=v
                leaf=set(m.split('.')[-1].split('_'))|set(m.split('.')[1:-1])
                w*=1+3*len({x.rstrip('s') for x in words}&{x.rstrip('s') for x in leaf})
                c[pk]+=w
        best=c.most_common(2)
        print(p.relative_to(repo/'tests'), '->', (best[0][0].replace('cbsr_qa_plugins','plugins').replace('cbsr_qa.','').replace('.','/') if best else '?'), [ (k.replace('cbsr_qa.',''),round(v,1)) for k,v in best[1:]])
