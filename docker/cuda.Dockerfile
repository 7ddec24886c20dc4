# maax_mjx on NVIDIA GPUs (driver 580 or later):
#   docker build -f docker/cuda.Dockerfile -t maax_mjx:cuda . && docker run --rm --gpus all maax_mjx:cuda info
FROM python:3.12.11-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends libegl1=1.6.* libgl1-mesa-dri=22.* \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /maax_mjx
COPY pyproject.toml README.md CHANGELOG.md LICENSE ./
COPY docker/constraints.txt constraints.txt
COPY maax_mjx maax_mjx
# CUDA's libraries come as wheels, with JAX's plugin.
# hadolint ignore=DL3013
RUN pip install --no-cache-dir -c constraints.txt ".[cuda,viewer]"
# Warp takes memory beside JAX, which otherwise takes three quarters of the GPU's at its start.
ENV XLA_PYTHON_CLIENT_MEM_FRACTION=0.6
RUN useradd --create-home --uid 1000 player \
    && mkdir /home/player/.cache && chown player: /home/player/.cache
USER 1000
WORKDIR /home/player
ENTRYPOINT ["maax-mjx"]
CMD ["info"]
