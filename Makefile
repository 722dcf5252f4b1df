# make run      a scattered cube recovers its shape on two ranks; results in results/scattered_cube
# make test     linters, then the tests serially and on 2 and 3 ranks
# make studies  what accuracy costs, short forms of all studies; make studies-long: the full ones, which take hours
# make docs     the site with gallery, guide, theory and reference, in build/docs (needs PyPI once); docs-check reads it
# make test-long, test-hard, bench, lint, clean
# `run` and `test` first install what is missing (setup.sh). Another scene: make run SCENE=app/scenes/twist.toml RANKS=4

SCENE ?= app/scenes/scattered_cube.toml
RANKS ?= 2
RESULTS ?= results/$(basename $(notdir $(SCENE)))
# the scene says which command runs it
PART = $(or $(shell sed -n 's/^part *= *"\([a-z]*\)".*/\1/p' $(SCENE)),elastic)

packages := app forms meshes mpm hawkes native obstacles
python := .venv/bin/python
# $(call peer,NAME,PACKAGES): a neighbour that `make bench` measures beside ours, in a venv of its own
peer = @[ -e build/peers/$1/ready ] || { /usr/bin/python3 -m venv --clear build/peers/$1 && \
    build/peers/$1/bin/python -m pip install -qq --disable-pip-version-check --no-input $2 && \
    touch build/peers/$1/ready; } || echo "bench: $1 cannot be installed; the table does without it" >&2
sweeps = $(sort $(wildcard app/studies/*.toml))
study := $(python) -m extremal.app study
export OMP_NUM_THREADS ?= 1
# Open MPI refuses to start as root (in a container, say) unless told twice
ifeq ($(shell id -u),0)
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
endif
# all ranks are on this machine: shared memory does, and Open MPI 5 need not complain about the network
export OMPI_MCA_btl ?= ^tcp
mpirun := mpirun --oversubscribe
pytest := $(python) -m pytest
parallel_pytest := $(python) -m pytest -p no:cacheprovider --color=no

.PHONY: run test test-long test-hard bench studies studies-long lint docs docs-check clean setup setup-dev
.DEFAULT_GOAL := run

run: setup
	rm -rf $(RESULTS)
	$(mpirun) -n $(RANKS) .venv/bin/extremal $(PART) $(SCENE) -o $(RESULTS)

test: lint
	$(pytest) -m "not long" --durations=10 --durations-min=5
	$(mpirun) -n 2 $(parallel_pytest) -m "mpi and not long"
	$(mpirun) -n 3 $(parallel_pytest) -m "mpi and not long"

test-long: setup-dev
	$(pytest) -m "long and not hard"
	$(mpirun) -n 2 $(parallel_pytest) -m "mpi and long and not hard"

# prints how many inputs were refused, how many kills survived, how far ranks differ, and the figures of the hard cases
test-hard: setup-dev
	$(pytest) -m hard
	$(mpirun) -n 2 $(parallel_pytest) -m "mpi and hard"

bench: setup
	$(python) -m extremal.app study cost
	$(call peer,taichi,"taichi==1.7.*")
	$(python) -m extremal.app study snow-cost
	$(call peer,clarabel,"clarabel==0.11.*" scipy)
	$(call peer,tick,"tick==0.8.*")
	$(python) -m extremal.app study hawkes-cost

# each short form takes a minute or two; the runs of tables and maps are so few that their figures are rough
studies: setup
	for sweep in $(sweeps); do $(study) $$sweep --quick -j 2 || exit 1; done
	for name in cost locking recovery snow-cost snow-effects snow-iterations solvers stability; do \
	    $(study) $$name --quick -o results/studies-quick/$$name || exit 1; done
	$(study) contour -o results/studies-quick/contour
	for name in table-3.1 table-3.2 hawkes-accuracy; do \
	    $(study) $$name --runs 3 -o results/studies-quick/$$name || exit 1; done
	$(study) figure-3.3 --runs 2 --points 5 -o results/studies-quick/figure-3.3

# finished points are kept: an interrupted `make studies-long` goes on where it was. What `recommend` ships is renewed.
studies-long: setup bench
	for sweep in $(sweeps); do $(study) $$sweep || exit 1; done
	for sweep in $(sweeps); do name=$$(basename $$sweep .toml | tr _ -); \
	    cp results/studies/$$name/study.json app/studies/fronts/$$name.json || exit 1; done
	for name in contour locking recovery snow-effects snow-iterations solvers stability table-3.1 table-3.2 \
	    hawkes-accuracy figure-3.3; do $(study) $$name || exit 1; done

# mypy wants the packages where their import names say: a folder of links does it
lint: setup-dev
	$(python) -m ruff check .
	@mkdir -p build/lint/extremal
	@for name in $(packages); do ln -sfn ../../../$$name build/lint/extremal/$$name; done
	MYPYPATH=build/lint $(python) -m mypy $(packages:%=-p extremal.%)

# where a package has an __all__, pdoc has to be told of its modules
documented = $(packages:%=extremal.%) \
    $(subst /,.,$(patsubst %.py,extremal.%,$(wildcard forms/[a-z]*.py meshes/[a-z]*.py)))

docs: setup
	./setup.sh docs
	rm -rf build/api
	$(python) -m pdoc -o build/api --docformat numpy --favicon "data:," $(documented) "!extremal[.].*[.]_[a-z]"
	NO_MKDOCS_2_WARNING=1 $(python) -m mkdocs build --clean
	@echo "the site: build/docs/index.html"

docs-check: docs
	./setup.sh site
	$(python) docs/site/check.py build/docs

clean:
	rm -rf build results .venv *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

setup:
	@./setup.sh
setup-dev:
	@./setup.sh dev
