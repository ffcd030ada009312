# Two images from one file: `agent` for agents and the plant, with numpy and Zenoh alone, and `orchestrator` with all.
#   docker build --target agent -t hedgerow-agent . && docker build --target orchestrator -t hedgerow .
# The base is pinned by its tag. To pin it by a digest that you have checked:
#   docker build --build-context python:3.12.11-slim-bookworm=docker-image://python@sha256:DIGEST …
FROM python:3.12.11-slim-bookworm AS base
ENV PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1
RUN useradd --create-home --uid 10001 hedgerow

FROM base AS build
WORKDIR /src
COPY pyproject.toml README.md LICENSE constraints.txt ./
COPY hedgerow hedgerow
COPY topologies topologies
COPY wire wire
COPY agents agents
COPY plant plant
COPY orchestrator orchestrator
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .
# Without pip in them: what runs has nothing that installs or builds.
RUN python -m venv --without-pip /opt/agent && python -m venv --without-pip /opt/orchestrator
RUN pip --python /opt/agent/bin/python install --no-cache-dir -c constraints.txt numpy eclipse-zenoh && pip --python /opt/agent/bin/python install --no-cache-dir --no-deps /wheels/hedgerow-*.whl
RUN pip --python /opt/orchestrator/bin/python install --no-cache-dir -c constraints.txt /wheels/hedgerow-*.whl

FROM base AS agent
COPY --from=build /opt/agent /opt/agent
ENV PATH=/opt/agent/bin:$PATH
USER hedgerow
WORKDIR /home/hedgerow
CMD ["hedgerow-agent"]

FROM base AS orchestrator
COPY --from=build /opt/orchestrator /opt/orchestrator
ENV PATH=/opt/orchestrator/bin:$PATH
USER hedgerow
WORKDIR /home/hedgerow
# A new volume takes its owner and mode from here; in a secure network everybody runs as who made the keys.
RUN mkdir runs && chmod 777 runs && chmod 755 .
CMD ["orchestrator", "--help"]
