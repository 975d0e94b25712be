"""The first of three ranks waits for sums of late ranks; it prints the sums and the time that it took."""

import json
import time

import numpy as np

from ngvisco.parallel.communicator import Communicator

ranks = Communicator.world()
own = np.arange(3.0) * ranks.rank if not ranks.is_first else np.zeros((3, 0))
ranks.total(0.0)
wall, processor = time.perf_counter(), time.process_time()
found = []
for _ in range(5):
    if not ranks.is_first:
        time.sleep(0.2)
    several = np.diag(own) if not ranks.is_first else own
    one = np.ones(several.shape[1])
    found.append(ranks.products(several, one).tolist())
    found.append([ranks.total(float(ranks.rank)), ranks.most(np.array([float(ranks.rank)]))])
wall, processor = time.perf_counter() - wall, time.process_time() - processor
same = ranks.gathered(found)
if ranks.is_first:
    print(json.dumps({"found": same, "share": processor / wall}))
