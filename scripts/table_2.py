#!/usr/bin/env python3
"""FreeTalk's Table 2: emotional speech to meshes, by what each stage was trained on.

python scripts/table_2.py --data CORPUS [--size full] [--settings '2+2' ...] [--pred NAME=DIR ...]
"""

from freetalk.tables import main

if __name__ == "__main__":
    raise SystemExit(main("table_2"))
