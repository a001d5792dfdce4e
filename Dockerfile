# The service in a container. Built in two stages: the first installs what requirements.lock pins, the
# second has Python, the packages and nothing else. Nothing is fetched when it runs.
#
#   docker build -t invid .
#   docker run --rm --network host -v invid-data:/data invid                    # the simulated cell
#   docker run --rm --network host -v invid-data:/data -v $PWD:/config:ro invid \
#     serve /config/robot.yaml --host 0.0.0.0 --key-file /config/keys.json --data-dir /data
#
# SocketCAN interfaces belong to the host's network, hence --network host. Beyond loopback the service
# refuses to start without a key.

FROM python:3.11-slim-bookworm AS build
WORKDIR /src
COPY requirements.lock pyproject.toml README.md LICENSE ./
COPY invid ./invid
COPY drivers ./drivers
COPY service ./service
RUN python -m venv /opt/invid
RUN /opt/invid/bin/python -m pip install --no-cache-dir --disable-pip-version-check -c requirements.lock ".[postgres,slcan,gs-usb]"
RUN /opt/invid/bin/invid --version

FROM python:3.11-slim-bookworm
COPY --from=build /opt/invid /opt/invid
RUN useradd --create-home --uid 10001 invid && install -d -o invid -g invid /data
USER invid
WORKDIR /data
VOLUME /data
ENV PATH=/opt/invid/bin:$PATH PYTHONUNBUFFERED=1 XDG_STATE_HOME=/data OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
    NUMBA_CACHE_DIR=/data/.numba MPLCONFIGDIR=/data/.matplotlib
EXPOSE 8000
HEALTHCHECK --interval=30s --timeout=5s --start-period=30s \
  CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/health/ready', timeout=4)"]
STOPSIGNAL SIGTERM
# Process 1 outlives the service until its runner has stopped the drives: with process 1 everything ends.
ENTRYPOINT ["python", "-m", "invid_service.supervision", "invid"]
CMD ["serve", "--host", "127.0.0.1", "--port", "8000", "--data-dir", "/data", "--json-logs"]
