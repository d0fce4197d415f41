import os; HERE=os.path.dirname(os.path.abspath(__file__))
import sys,ast,collections,re
sys.argv=['x',sys.argv[1]]
exec(open(HERE+'/graph.py').read().split("if __name__")[0])
short=lambda m: m.replace('cbsr_qa_plugins','P') if m.startswith('cbsr_qa_plugins') else m.removeprefix('cbsr_qa.')
full=lambda s: 'cbsr_qa_plugins'+s[1:] if s.startswith('P.') or s=='P' else 'cbsr_qa.'+s
mp={};new={}
for l in open(HERE+'/modules.txt'):
    l=l.strip()
    if not l or l[0]=='#': continue
    n,o=l.split(':',1)
    for x in o.split('+'):
        x=x.strip(); assert x not in mp,x; mp[x]=n
    new[n]=[x.strip() for x in o.split('+')]
olds={short(m) for m,p in mods.items() if p.name!='__init__.py' and not m.startswith('cbsr_qa._')}
print('unmapped',sorted(olds-set(mp))); print('unknown',sorted(set(mp)-olds))
L={short(m):len(p.read_text().splitlines()) for m,p in mods.items()}
for n,o in new.items():
    s=sum(L.get(x,0) for x in o)
    if s>350 and len(o)>1: print('long',n,s)
pk={n.rsplit('.',1)[0] for n in new}
for q in list(pk):
    while '.' in q:
        q=q.rsplit('.',1)[0]; pk.add(q)
print('files',len(new)+len(pk)+1, 'packages',len(pk))
ent=collections.Counter()
for n in new: ent[n.rsplit('.',1)[0] if '.' in n else '']+=1
for q in pk: ent[q.rsplit('.',1)[0] if '.' in q else '']+=1
print([ (q,c+1) for q,c in ent.most_common(8)])
# module graph after
inits={m for m,p in mods.items() if p.name=='__init__.py'}
E=collections.defaultdict(set); W=collections.defaultdict(set)
for m,s in imps.items():
    if m in inits and short(m) not in ('interfaces',): continue
    a=mp.get(short(m))
    for x in s:
        b=mp.get(short(x))
        if x=='cbsr_qa.interfaces': b='plugin.interfaces'
        if a and b and a!=b:
            E[a].add(b)
            pa,pb=a.rsplit('.',1)[0],b.rsplit('.',1)[0]
            if pa!=pb: W[pa,pb].add((a,b))
def scc(nodes,edges):
    idx={};low={};st=[];on=set();out=[];c=[0]
    sys.setrecursionlimit(10000)
    def f(v):
        idx[v]=low[v]=c[0];c[0]+=1;st.append(v);on.add(v)
        for w in edges.get(v,()):
            if w not in idx: f(w);low[v]=min(low[v],low[w])
            elif w in on: low[v]=min(low[v],idx[w])
        if low[v]==idx[v]:
            comp=[]
            while True:
                w=st.pop();on.discard(w);comp.append(w)
                if w==v:break
            if len(comp)>1: out.append(comp)
    for v in nodes:
        if v not in idx:f(v)
    return out
print('module circles',scc(list(new),E))
PE=collections.defaultdict(set)
for (a,b) in W: PE[a].add(b)
for comp in scc(list(pk),PE):
    print('PACKAGE circle',comp)
    for (a,b),s in sorted(W.items()):
        if a in comp and b in comp: print('   ',a,'->',b,len(s),sorted(s)[:4])
U=collections.defaultdict(set)
for a,s in E.items():
    for b in s: U[b].add(a)
one=[n for n in new if len(U[n])==1]
print('single user',len(one)); 
if len(sys.argv)>1: 
    for n in one: print('  1:',n,sum(L.get(x,0) for x in new[n]),'<-',*U[n])
if len(sys.argv)>1:
    print('SMALL')
    for n in new:
        s=sum(L.get(x,0) for x in new[n])
        if s<=125: print('  ',n,s,'<-',len(U[n]),*(sorted(U[n])[:2] if len(U[n])<3 else ''))
