"""`python -m makers.benchmark [FOLDER ...]`, see `board.main`."""

from makers.benchmark.board import main

main()
