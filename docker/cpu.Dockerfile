# maax_mjx on CPUs:   docker build -f docker/cpu.Dockerfile -t maax_mjx . && docker run --rm maax_mjx rollout tag --worlds 16
# What it writes stays with -v "$PWD/maax-out:/home/player/maax-out" (and runs of train with runs); user 1000 has to be allowed to write there.
FROM python:3.12.11-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends libegl1=1.6.* libgl1-mesa-dri=22.* \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /maax_mjx
COPY pyproject.toml README.md CHANGELOG.md LICENSE ./
COPY docker/constraints.txt constraints.txt
COPY maax_mjx maax_mjx
# hadolint ignore=DL3013
RUN pip install --no-cache-dir -c constraints.txt ".[viewer]" \
    && useradd --create-home --uid 1000 player \
    && mkdir /home/player/.cache && chown player: /home/player/.cache
USER 1000
WORKDIR /home/player
ENTRYPOINT ["maax-mjx"]
CMD ["info"]
