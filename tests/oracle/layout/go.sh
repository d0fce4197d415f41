sed -i 's/^from cbsr_qa.analysis.recording_images import Array, /from cbsr_qa.analysis.recording_images import /' cbsr_qa/analysis/recording_imaged_events.py
sed -i 's/^Indices = NDArray\[np.int32\]/SparseIndices = NDArray[np.int32]/; s/\bIndices\b/SparseIndices/g; s/SparseSparseIndices/SparseIndices/g' cbsr_qa/forward/refinement.py && python3 - <<'EOP'
from pathlib import Path
p=Path('cbsr_qa/analysis/recording_imaged_events.py'); t=p.read_text()
i=t.index('\n\n\n')
t=t[:i]+"\n\nArray = NDArray[np.float64]"+t[i:]
t=t.replace("from dataclasses import dataclass\n","from dataclasses import dataclass\n\nimport numpy as np\nfrom numpy.typing import NDArray\n",1)
p.write_text(t)
EOP
