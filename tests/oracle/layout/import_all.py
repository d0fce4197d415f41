import sys,importlib,pkgutil,traceback
from pathlib import Path
root=Path(sys.argv[1]); sys.path[:0]=[str(root),str(root/'plugins')]
import importlib.machinery
bad=0
for base,pre in((root/'cbsr_qa','cbsr_qa'),(root/'plugins/cbsr_qa_plugins','cbsr_qa_plugins')):
    for p in sorted(base.rglob('*.py')):
        m='.'.join([pre,*p.relative_to(base).with_suffix('').parts]).removesuffix('.__init__')
        try: importlib.import_module(m)
        except BaseException as e:
            bad+=1; print(m,type(e).__name__,str(e)[:200])
print('bad',bad)
