# One image for API, worker and the whole service in one container (the default command).
FROM python:3.11-slim AS build
WORKDIR /src
RUN python -m venv /opt/tomosim
ENV PATH=/opt/tomosim/bin:$PATH
COPY requirements.lock ./
RUN pip install --no-cache-dir --disable-pip-version-check --require-hashes -r requirements.lock
COPY pyproject.toml README.md LICENSE ./
COPY simcore simcore
COPY worker worker
COPY api api
COPY tomosim_contract tomosim_contract
COPY tomosim tomosim
RUN pip install --no-cache-dir --disable-pip-version-check --no-deps --no-build-isolation .

FROM python:3.11-slim
# /data is the only place that is written to, besides /tmp: volumes mounted there take over its owner.
RUN groupadd --gid 10001 tomosim && useradd --uid 10001 --gid 10001 --home-dir /data --no-create-home tomosim \
    && install -d -o tomosim -g tomosim -m 0700 /data
COPY --from=build /opt/tomosim /opt/tomosim
# Compiled kernels are kept in the data volume: the image may be read only.
ENV PATH=/opt/tomosim/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/data/cache/numba \
    MPLCONFIGDIR=/tmp \
    TOMOSIM_DATA_FOLDER=/data
WORKDIR /data
USER 10001:10001
EXPOSE 8080
VOLUME /data
# Of the default command; compose has its own for each service.
HEALTHCHECK --interval=15s --timeout=6s --start-period=60s \
    CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8080/livez', timeout=5)"]
CMD ["tomosim", "serve"]
