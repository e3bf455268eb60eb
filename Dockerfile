# dpbench on Python 3.13 without a compiler; docs/guide/containers.md has the commands.
ARG PYTHON=docker.io/library/python:3.13.14-slim-bookworm@sha256:67a1e1f215ccda113cfc024e8639049257e88f273898f595b61476d128d387e8

FROM ${PYTHON} AS build
WORKDIR /source
COPY . .
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM ${PYTHON}
COPY constraints.txt /
COPY --from=build /wheels /wheels
RUN python -m pip install --no-cache-dir --only-binary :all: --constraint /constraints.txt /wheels/*.whl \
    && rm -r /wheels /constraints.txt \
    && python -m dpbench.cli.compiling
RUN useradd --create-home --uid 1000 dpbench && install --directory --owner dpbench /results
USER dpbench
WORKDIR /results
ENTRYPOINT ["dpbench"]
CMD ["--help"]
