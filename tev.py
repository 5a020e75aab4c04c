import time,numpy as np,tempfile
from pathlib import Path
from omnisyn_cli.training.evidence_pool import *
from omnisyn_cli.training import evidence_pool as ep
from omnisyn_cli.training.pool import TiltedConfig,STOPS
from omnisyn_cli.scenes import render_panorama
c=TiltedConfig(size=(256,512))
make_evidence(Path('/tmp/tev'),4,c)
for s in range(5,9):
    t=time.process_time(); make_evidence(Path('/tmp/tev'),s,c); print(s,'all',round(time.process_time()-t,1))
    f=c.scene(s,STOPS)
    if f is None: continue
    sc,p=f
    for ss in (1,2):
        t=time.process_time(); render_panorama(sc,p[0],(512,1024),supersample=ss,threads=1); print('  render',ss,round(time.process_time()-t,2))
