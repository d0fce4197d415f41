"""Moves modules by a map, merging those that share a new name; imports, registry strings and pages follow.

usage: move.py REPO MAP [--check]
Only text is edited: bodies are kept verbatim, so that the multiset of functions and classes stays.
"""
import ast, collections, re, subprocess, sys
from pathlib import Path

repo = Path(sys.argv[1]).resolve()
check = '--check' in sys.argv
ROOTS = {'cbsr_qa': repo/'cbsr_qa', 'cbsr_qa_plugins': repo/'plugins/cbsr_qa_plugins'}

def full(s):
    return 'cbsr_qa_plugins'+s[1:] if s == 'P' or s.startswith('P.') else 'cbsr_qa.'+s

new_of, sources = {}, {}
for line in open(sys.argv[2]):
    line = line.split('#')[0].strip()
    if not line: continue
    n, o = line.split(':', 1)
    olds = [full(x.strip()) for x in o.split('+')]
    sources[full(n.strip())] = olds
    for x in olds:
        assert x not in new_of, x
        new_of[x] = full(n.strip())

def path_of(module):
    root, *rest = module.split('.')
    return ROOTS[root].joinpath(*rest).with_suffix('.py') if rest else ROOTS[root]/'__init__.py'

old_modules, old_packages = set(), set()
for root, base in ROOTS.items():
    for p in base.rglob('*.py'):
        parts = [root, *p.relative_to(base).with_suffix('').parts]
        if parts[-1] == '__init__':
            old_packages.add('.'.join(parts[:-1]))
        else:
            old_modules.add('.'.join(parts))
missing = old_modules - set(new_of)
assert not missing, sorted(missing)
# names that old package doors offer (only interfaces had one): package.name -> module
door = {}
for pk in old_packages:
    p = ROOTS[pk.split('.')[0]].joinpath(*pk.split('.')[1:])/'__init__.py'
    for n in ast.parse(p.read_text()).body:
        if isinstance(n, ast.ImportFrom) and n.module:
            for a in n.names:
                door[pk, a.asname or a.name] = (n.module, a.name)

def target(module, name):
    """(new module, name, is_module) that `from module import name` means, or None where it is not ours."""
    if module in old_modules:
        return new_of[module], name, False
    if module in old_packages:
        if f'{module}.{name}' in old_modules:
            return new_of[f'{module}.{name}'], None, True
        if (module, name) in door:
            m, n = door[module, name]
            return target(m, n)
    return None

class Lines:
    def __init__(self, text):
        self.text = text
        self.starts = [0]
        for l in text.splitlines(keepends=True):
            self.starts.append(self.starts[-1]+len(l))
        self.raw = text.splitlines(keepends=True)
    def pos(self, line, col):
        # ast columns are utf-8 bytes
        l = self.raw[line-1]
        return self.starts[line-1] + len(l.encode()[:col].decode())

MARK = 'cbsrQQqa'  # an import that is rewritten already is not rewritten again as text


def render(module, names, indent):
    """One import statement; names: list of (name, asname)."""
    module = module.replace('cbsr_qa', MARK, 1)
    words = sorted({n if not a or a == n else f'{n} as {a}' for n, a in names}, key=lambda w: w)
    return f"from {module} import {', '.join(words)}" if len(words) < 8 and len(', '.join(words)) < 80 else \
        f"from {module} import (\n" + ''.join(f"{indent}    {w},\n" for w in words) + f"{indent})"

def rewrite_imports(text, importer=None):
    """Rewrite import statements to new modules. Returns text."""
    try:
        tree = ast.parse(text)
    except SyntaxError:
        return text
    L = Lines(text)
    edits = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module and node.module.split('.')[0] in ROOTS:
            groups = collections.OrderedDict()
            changed = False
            for a in node.names:
                t = target(node.module, a.name)
                if t is None:
                    groups.setdefault(node.module, []).append((a.name, a.asname))
                    continue
                changed = True
                m, name, ismod = t
                if ismod:
                    pk, leaf = m.rsplit('.', 1)
                    local = a.asname or a.name
                    groups.setdefault(pk, []).append((leaf, None if local == leaf else local))
                else:
                    local = a.asname or a.name
                    groups.setdefault(m, []).append((name, None if local == name else local))
            if changed:
                start, end = L.pos(node.lineno, node.col_offset), L.pos(node.end_lineno, node.end_col_offset)
                indent = ' ' * node.col_offset
                out = []
                for m, names in groups.items():
                    if importer and m == importer:
                        # names of a module merged into this one: kept only where they are renamed
                        for n, a in names:
                            assert not a or a == n, (importer, n, a)
                        continue
                    out.append(render(m, names, indent))
                edits.append((start, end, ('\n'+indent).join(out) if out else 'pass  # MOVED'))
        elif isinstance(node, ast.Import):
            for a in node.names:
                if a.name in new_of or a.name in old_packages:
                    if a.name in new_of:
                        start, end = L.pos(node.lineno, node.col_offset), L.pos(node.end_lineno, node.end_col_offset)
                        assert len(node.names) == 1
                        edits.append((start, end, f"import {new_of[a.name].replace('cbsr_qa', MARK, 1)}" + (f" as {a.asname}" if a.asname else '')))
    for start, end, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[end:]
    return re.sub(r'^[ \t]*pass  # MOVED\n', '', text, flags=re.M)

_dotted = re.compile(r'\b(cbsr_qa(?:_plugins)?(?:\.\w+)+)')
def rewrite_strings(text):
    """Rewrite dotted paths anywhere (strings, comments, pages): the longest old module that leads it."""
    def one(m):
        words = m[1].split('.')
        for n in range(len(words), 1, -1):
            head = '.'.join(words[:n])
            if head in new_of:
                return '.'.join([new_of[head], *words[n:]])
        return m[1]
    return _dotted.sub(one, text).replace(MARK, 'cbsr_qa')

_pathlike = re.compile(r'\b((?:plugins/)?cbsr_qa(?:_plugins)?(?:/\w+)+)\.py\b')
def rewrite_paths(text):
    def one(m):
        mod = m[1].removeprefix('plugins/').replace('/', '.')
        if mod in new_of:
            n = new_of[mod]
            return ('plugins/' if n.startswith('cbsr_qa_plugins') else '') + n.replace('.', '/') + '.py'
        return m[0]
    return _pathlike.sub(one, text)

def split(text):
    """docstring text, import nodes' text (top), TYPE_CHECKING block lines, body text."""
    tree = ast.parse(text)
    L = Lines(text)
    body = tree.body
    doc = ast.get_docstring(tree, clean=False) or ''
    i = 0
    if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant) and isinstance(body[0].value.value, str):
        i = 1
    imports, checking = [], []
    last_end = L.pos(body[0].end_lineno, body[0].end_col_offset) if i else 0
    j = i
    while j < len(body) and (isinstance(body[j], (ast.Import, ast.ImportFrom)) or
          (isinstance(body[j], ast.If) and getattr(body[j].test, 'id', '') == 'TYPE_CHECKING')):
        n = body[j]
        if isinstance(n, ast.If):
            for k in n.body:
                checking.append(ast.get_source_segment(text, k))
        else:
            imports.append(ast.get_source_segment(text, n))
        last_end = L.pos(n.end_lineno, n.end_col_offset)
        j += 1
    # a trailing comment on the last import line belongs to it
    rest = text[last_end:]
    line, nl, after = rest.partition('\n')
    rest = after if line.strip() == '' or line.strip().startswith('#') else rest
    if line.strip().startswith('#') and imports:
        imports[-1] += '  ' + line.strip()
    return doc, imports, checking, rest.strip('\n') + '\n'

def top_names(text):
    names = {}
    for n in ast.parse(text).body:
        if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            names[n.name] = 'def'
        elif isinstance(n, (ast.Assign, ast.AnnAssign, ast.AugAssign)):
            for t in (n.targets if isinstance(n, ast.Assign) else [n.target]):
                for x in ast.walk(t):
                    if isinstance(x, ast.Name): names[x.id] = 'var'
        elif isinstance(n, ast.TypeAlias) if hasattr(ast, 'TypeAlias') else False:
            names[n.name.id] = 'type'
    return names

def import_names(text):
    out = {}
    for n in ast.walk(ast.parse(text)):
        if isinstance(n, ast.ImportFrom):
            for a in n.names: out[a.asname or a.name] = (n.module, a.name)
        elif isinstance(n, ast.Import):
            for a in n.names: out[a.asname or a.name.split('.')[0]] = (a.name, None)
    return out

def assignments(text):
    """Name -> source of simple top-level assignments."""
    out = {}
    for n in ast.parse(text).body:
        if isinstance(n, (ast.Assign, ast.AnnAssign)):
            tgt = n.targets[0] if isinstance(n, ast.Assign) else n.target
            if isinstance(tgt, ast.Name):
                out[tgt.id] = (ast.dump(n), n.lineno, n.end_lineno)
    return out

def without_lines(text, spans):
    lines = text.splitlines(keepends=True)
    for a, b in sorted(spans, reverse=True):
        del lines[a-1:b]
    return ''.join(lines)

def renamed(text, name, new):
    """Rename a module-level private name: every Name node and global of it (no attribute of that name)."""
    tree = ast.parse(text); L = Lines(text); spots = []
    for n in ast.walk(tree):
        if isinstance(n, ast.Name) and n.id == name:
            spots.append((L.pos(n.lineno, n.col_offset), len(name)))
        elif isinstance(n, (ast.FunctionDef, ast.ClassDef)) and n.name == name:
            start = L.pos(n.lineno, n.col_offset)
            spots.append((text.index(name, start), len(name)))
    for a, k in sorted(set(spots), reverse=True):
        text = text[:a] + new + text[a+k:]
    return text

SAME = {('cbsr_qa.calibration.fits.steady_state', 'learn_kernel'): ('cbsr_qa.calibration.fits.relaxation_kernel', 'learn_kernel')}
renames = []
problems = []
outputs = {}
for new, olds in sources.items():
    given = {o: path_of(o).read_text() for o in olds}
    needs = {o: {x for x in olds if x != o and re.search(rf'^from {re.escape(x)} import', t, re.M)} for o, t in given.items()}
    ordered = []
    while len(ordered) < len(olds):
        free = [o for o in olds if o not in ordered and needs[o] <= set(ordered)]
        if not free: free = [o for o in olds if o not in ordered][:1]; print('CIRCLE in', new, needs)
        ordered.append(free[0])
    texts = [(o, given[o]) for o in ordered]
    if len(olds) == 1:
        outputs[new] = rewrite_imports(texts[0][1], new)
        continue
    seen = {}; imported = {}; before = {}
    docs, imports, checking, bodies = [], [], [], []
    for o, t in texts:
        t = rewrite_imports(t, new)
        mine = assignments(t)
        same = [n for n, (d, a, b) in mine.items() if n in before and before[n] == d]
        t = without_lines(t, [mine[n][1:] for n in same])
        stem = o.rsplit('.', 1)[1].strip('_')
        for name in sorted(top_names(t)):
            if name in seen and name.startswith('_') and not name.startswith('__'):
                short = name + '_' + (stem.upper() if name.isupper() else stem)
                renames.append((o, name, short))
                t = renamed(t, name, short)
        before |= {n: d for n, (d, a, b) in assignments(t).items()}
        for name, kind in top_names(t).items():
            if name in seen and seen[name] != o and not name.startswith('__all__'):
                problems.append((new, name, seen[name], o))
            seen.setdefault(name, o)
        for name, what in import_names(t).items():
            what = ((what[0] or '').replace(MARK, 'cbsr_qa'), what[1]); what = SAME.get(what, what)
            if name in imported and imported[name][0] != what:
                problems.append((new, f'import {name}', imported[name], (what, o)))
            imported.setdefault(name, (what, o))
        d, i, c, b = split(t)
        docs.append(d.strip()); imports += i; checking += c; bodies.append(b)
    for name, (what, o) in imported.items():
        if name in seen and seen[name] != o:
            problems.append((new, f'import {name} from {what} in {o} and defined in', seen[name], ''))
    # the last of a merge is the main one: helpers stand before it
    doc = docs[-1] if new.rsplit('.',1)[1] not in [o.rsplit('.',1)[1] for o in olds] else docs[[o.rsplit('.',1)[1] for o in olds].index(new.rsplit('.',1)[1])]
    others = [d for d in docs if d != doc]
    text = '"""' + doc + ''.join('\n\n' + d for d in others) + ('\n"""' if others or '\n' in doc else '"""') + '\n\n'
    text += '\n'.join(dict.fromkeys(imports)) + '\n'
    if checking:
        if not any('TYPE_CHECKING' in i for i in imports):
            text = text.rstrip('\n') + '\nfrom typing import TYPE_CHECKING\n'
        text += '\nif TYPE_CHECKING:\n' + ''.join('    ' + c.replace('\n', '\n') + '\n' for c in dict.fromkeys(checking))
    text += '\n\n' + '\n\n'.join(bodies)
    outputs[new] = text

for r in renames: print('RENAME', *r)
for p in problems: print('PROBLEM', *p)
print(len(problems), 'problems,', len(outputs), 'modules')
if check: sys.exit(bool(problems))
if problems: sys.exit(1)

tracked = subprocess.run(['git', 'ls-files'], cwd=repo, capture_output=True, text=True, check=True).stdout.split('\n')
# everything else that names modules
for f in tracked:
    p = repo/f
    if not f or not p.is_file() or p.suffix not in {'.py', '.md', '.toml', '.sh', '.j2', '.in', '.txt', '.mako', ''} : continue
    if f.startswith('CHANGELOG') or f.startswith('docs/decisions'): pass
    t = p.read_text()
    u = t
    module = None
    if f.endswith('.py') and (f.startswith('cbsr_qa/') or f.startswith('plugins/cbsr_qa_plugins/')):
        if not f.endswith('__init__.py'): continue
    if f.endswith('.py'): u = rewrite_imports(u)
    if f.endswith('.md'):
        u = re.sub(r'(?ms)^(```python\n)(.*?)(^```)', lambda m: m[1]+rewrite_imports(m[2])+m[3], u)
    u = rewrite_paths(rewrite_strings(u))
    if u != t: p.write_text(u)

for o in sorted(old_modules):
    if o not in sources:
        subprocess.run(['git', 'rm', '-q', '--cached', str(path_of(o))], cwd=repo, check=True)
        path_of(o).unlink()
for new, text in outputs.items():
    p = path_of(new)
    p.parent.mkdir(parents=True, exist_ok=True)
    q = p.parent
    while not (q/'__init__.py').exists():
        (q/'__init__.py').write_text(f'"""TODO {q.name}."""\n'); q = q.parent
    p.write_text(rewrite_paths(rewrite_strings(text)))
