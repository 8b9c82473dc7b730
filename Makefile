# The service in one word: make run. Everything for developers: make install, then the rest.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
HOST := $(or $(NEURALMUSIC_HOST),127.0.0.1)
# An address that stands for every interface is none that a client can call.
REACHED := $(if $(filter 0.0.0.0 ::,$(HOST)),127.0.0.1,$(HOST))
PORT := $(or $(NEURALMUSIC_PORT),8000)

.PHONY: help install run dist test test-costs test-dist test-docker test-faults test-fuzz test-learns test-page test-processes test-ray test-soak lint types format bench contracts docs audit clean

help:
	@echo "make run      install and start the service with its embedded model (no torch)"
	@echo "make test     install everything and run the tests (3 minutes)"
	@echo "make test-page    the web page in a headless Chromium"
	@echo "make test-processes  workers and services that reload, drain, restart and die"
	@echo "make test-costs   CPU time and memory against sizes"
	@echo "make dist     wheels and sdists of the client and the service, into dist/"
	@echo "make test-dist   install them into fresh environments, on every Python that is here"
	@echo "make test-docker  build the image, start it as docs/deployment.md says, restart it under load"
	@echo "make test-faults  killed workers and replicas, cut networks, full disks (as root)"
	@echo "make test-fuzz    hostile requests, uploads and streams by the thousand"
	@echo "make test-learns  trainings that have to get somewhere, a whole evaluation, every experiment"
	@echo "make test-soak    a minute of robots, churn and faults"
	@echo "make test-ray     replicas and batches on Ray, which it installs"
	@echo "make install  only install everything, torch for the CPU included"
	@echo "make lint     ruff, formatting, openapi.yaml"
	@echo "make types    mypy, strict on client/ and service/"
	@echo "make format   let ruff format and fix"
	@echo "make bench    windows beside pyroomacoustics, streams, files, memory, start (6 minutes)"
	@echo "make contracts  write openapi.yaml, asyncapi.json, docs/cli.md, docs/python.md, docs/protocol.md's tables"
	@echo "make docs     the documents as a site, build/site; fails on broken links"
	@echo "make audit    known vulnerabilities of what is installed, where PyPI or OSV answers"

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "The service needs Python 3.11 or newer, but $(PYTHON) is %d.%d: make PYTHON=python3.11 (or a newer one)" % sys.version_info[:2])'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.ready: pyproject.toml client/pyproject.toml | $(BIN)/python
	@echo "Installing the service into $(VENV): about 400 MB, a minute or two ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ./client --editable .
	@touch $@

$(VENV)/.installed: pyproject.toml client/pyproject.toml | $(BIN)/python
	@echo "Installing everything for developers into $(VENV), torch included: 2 GB, some minutes ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ./client --editable '.[dev]'
	@touch $@ $(VENV)/.ready

install: $(VENV)/.installed

run: $(VENV)/.ready
	@echo
	@echo "Once the service is up, localize the sample recording from another terminal:"
	@echo
	@echo "  curl -s -F audio=@examples/two-talkers.flac -F array=respeaker-usb-4mic-v2 http://$(REACHED):$(PORT)/localize"
	@echo
	@exec $(BIN)/neuralmusic serve --host $(HOST) --port $(PORT)

# Tests start a hundred processes of the service: each would compile it again.
unexport PYTHONDONTWRITEBYTECODE

# Two processes, a file in one of them: half of the tests' time is waiting for processes to start.
test: install
	$(BIN)/python -m pytest -n 2 --dist loadfile

test-costs test-dist test-docker test-faults test-fuzz test-learns test-page test-processes test-soak: test-%: install
	$(BIN)/python -m pytest -m $* -rs

dist: install
	rm -rf dist
	$(BIN)/python -m build --quiet --outdir dist client
	$(BIN)/python -m build --quiet --outdir dist .

test-ray: install
	$(BIN)/python -m pip install --quiet --editable ./client --editable '.[ray]'
	$(BIN)/python -m pytest -m ray -rs

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: install
	$(BIN)/mypy

format: install
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: install
	$(BIN)/python tests/bench/performance.py

contracts: install
	$(BIN)/python -m service.openapi > openapi.yaml
	$(BIN)/python -m service.api.contract.asyncapi > asyncapi.json
	$(BIN)/python -m service.api.contract.asyncapi docs/protocol.md
	$(BIN)/python -m service.reference.commands > docs/cli.md
	$(BIN)/python -m service.reference.names > docs/python.md

docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

audit: install
	.ci/audit

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache build dist
