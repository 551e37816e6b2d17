# The image for a vehicle's computer (amd64, arm64): `insonify live` on the robot's bus.
# docs/onboard.md says how it is built and run.

ARG PYTHON=python:3.12-slim-bookworm

FROM ${PYTHON} AS build
ARG EXTRAS=live,view,maps,mavlink,waterlinked
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
RUN python -m venv /opt/insonify

# cyclonedds has no wheel for arm64.  There its C library is built first, if its source lies in
# cyclonedds/ beside this file; without it the image knows no bus (live --from, map, plan, view).
RUN --mount=type=bind,target=/context \
    if [ "$(uname -m)" = aarch64 ] && [ -f /context/cyclonedds/CMakeLists.txt ]; then \
      apt-get update && apt-get install -y --no-install-recommends cmake g++ make \
      && cmake -S /context/cyclonedds -B /tmp/cyclonedds -DCMAKE_BUILD_TYPE=Release \
        -DCMAKE_INSTALL_PREFIX=/opt/insonify/cyclonedds -DCMAKE_INSTALL_LIBDIR=lib \
        -DBUILD_TESTING=OFF -DBUILD_EXAMPLES=OFF -DENABLE_ICEORYX=OFF \
        -DENABLE_SSL=OFF -DENABLE_SECURITY=OFF \
      && cmake --build /tmp/cyclonedds --target install --parallel \
      && CYCLONEDDS_HOME=/opt/insonify/cyclonedds /opt/insonify/bin/pip install \
        -c /context/constraints.txt cyclonedds; \
    fi

WORKDIR /source
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY src src
RUN /opt/insonify/bin/pip install -c constraints.txt ".[${EXTRAS}]"

FROM ${PYTHON}
# libgomp1: the threads of the kernels
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --uid 1000 insonify \
    && install -d -o insonify -g insonify /data /recordings /var/cache/insonify
COPY --from=build /opt/insonify /opt/insonify
ENV PATH=/opt/insonify/bin:$PATH \
    NUMBA_CACHE_DIR=/var/cache/insonify \
    MPLCONFIGDIR=/var/cache/insonify/matplotlib
USER insonify
WORKDIR /data
# For any user, since who runs it may be another (--user)
RUN insonify warm-up --quiet && chmod -R a+rwX /var/cache/insonify
# Results and what `live` records; recordings to be read
VOLUME ["/data", "/recordings"]
# The view, Foxglove
EXPOSE 8080 8765
HEALTHCHECK --interval=30s --timeout=10s --start-period=120s --retries=3 \
    CMD ["insonify", "doctor", "--live", "/data"]
ENTRYPOINT ["insonify"]
CMD ["live"]
