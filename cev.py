import numpy as np
from pathlib import Path
from omnisyn_cli.training.evidence_pool import *
from omnisyn_cli.training.evidence_pool import EvidencePair
from omnisyn_cli.training.data import load_samples
from omnisyn_cli.training.pool import TiltedConfig
c=TiltedConfig(size=(256,512))
for s in (5,6,7):
    make_evidence(Path('/tmp/tev2'),s,c)
    for d in ('/tmp/tev','/tmp/tev2'):
        for p in load_samples(Path(d)/f'{s:08d}.npz',EvidencePair)[:1]:
            a=(p.planes[5]>0)&(p.planes[6]==0); u=(p.planes[5]==0)&(p.planes[6]==0)
            r=np.abs(p.planes[3]**2/np.maximum(p.root**2,1e-9)-1)
            print(s,d,'agreed %.3f'%a.mean(),'within5 %.3f'%(r[a]<.05).mean(),'med root err %.4f'%np.median(abs(p.planes[3]-p.root)[a]),'unsure %.3f within5 %.3f err %.4f'%(u.mean(),(r[u]<.05).mean(),abs(p.planes[3]-p.root)[u].mean()))
