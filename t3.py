import sys, traceback, time
from concurrent.futures import ProcessPoolExecutor
from tests.identify.wrong_models import *
def go(g):
    t=time.time()
    try:
        ok, fit = judge_wrong(*g)
        return g, ok, [f"[{d.place}] {d.text}" for d in fit.doubts]+[f"note: {n}" for n in fit.notes], time.time()-t, {k:(round(e.value,4)) for k,e in fit.estimates.items()}
    except Exception as e: return g, None, [repr(e)[:300]], time.time()-t, {}
if __name__=="__main__":
    seed=int(sys.argv[1]); names=sys.argv[2:]
    cases=[c for c in campaign(seed)[0] if not names or any(n in c[0] for n in names)]
    with ProcessPoolExecutor(2) as pool:
        n=0
        for g, ok, d, t, e in pool.map(go, cases):
            n+=bool(ok)
            print("*" if ok else " ", g, f"{t:.1f} s", e)
            for x in d: print("      ", x, flush=True)
        print(n, len(cases))
