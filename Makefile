PYTHONS = $(shell ls -d $(CURDIR)/.venv/3.*/bin/python 2>/dev/null | paste -sd';')
TOOLS = .venv/3.11/bin
BUILD = build/cmake
build:
	@$(TOOLS)/cmake -S . -B $(BUILD) -G Ninja -DCMAKE_MAKE_PROGRAM=$(CURDIR)/$(TOOLS)/ninja -DDYNAMORPH_PYTHONS="$(PYTHONS)" -DDYNAMORPH_TESTS=ON --log-level=WARNING
	@nice $(TOOLS)/cmake --build $(BUILD) -j2 -- -k 0
	@for p in .venv/3.*/lib/python*/site-packages; do printf '%s\n' $(CURDIR)/$(BUILD)/python $(CURDIR)/addon > $$p/dynamorph.pth; done
.PHONY: build
