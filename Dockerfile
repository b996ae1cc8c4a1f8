# mapperd for Linux computers with Docker, on x86-64 and ARM64, and for BlueOS as an extension:
# docs/getting-started/install.md. Settings, recordings and maps are in /data.
FROM python:3.13-slim-bookworm AS build
RUN apt-get update \
    && apt-get install -y --no-install-recommends g++ make \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY requirements/build.lock requirements/
RUN pip install --no-cache-dir --require-hashes -r requirements/build.lock
COPY . .
RUN pip wheel --no-cache-dir --no-build-isolation --no-deps --wheel-dir /wheels .

FROM python:3.13-slim-bookworm
COPY requirements/vehicle.lock /tmp/
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir --require-hashes -r /tmp/vehicle.lock \
    && pip install --no-cache-dir --no-deps /wheels/*.whl \
    && rm -r /tmp/vehicle.lock /wheels \
    && mkdir -p /data
ENV XDG_CONFIG_HOME=/data/config XDG_STATE_HOME=/data/state PYTHONUNBUFFERED=1
VOLUME /data
WORKDIR /data

LABEL org.opencontainers.image.title="mapperd" \
      org.opencontainers.image.description="Live 3D maps from Oculus multibeam imaging sonars" \
      org.opencontainers.image.licenses="Apache-2.0"
# What BlueOS reads of an extension. The host's network brings the sonar's broadcasts and the
# autopilot's datagrams.
LABEL version="0.2.0"
LABEL permissions='{\
  "HostConfig": {\
    "Binds": ["/usr/blueos/extensions/mapperd:/data"],\
    "NetworkMode": "host"\
  }\
}'
LABEL authors='[{"name": "The mapperd maintainers", "email": ""}]'
LABEL company='{"name": "The mapperd maintainers", "about": "", "email": ""}'
LABEL type="device-integration"
LABEL tags='["sonar", "mapping", "data-collection"]'
LABEL links='{}'
LABEL requirements="core >= 1.1"

# Without settings mapperd lists what it hears and starts no sonar.
CMD ["sh", "-c", "until [ -e /data/config/mapperd/mapperd.yaml ]; do mapperd; sleep 30; done; exec mapperd --out /data/last"]
