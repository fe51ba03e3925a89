# docker build -t mrtask . && docker run --rm --shm-size=2g -v "$PWD/outputs:/mrtask/outputs" mrtask reproduce EXPERIMENT=smoke
FROM python:3.11-slim

RUN apt-get update && apt-get install --yes --no-install-recommends make && rm -rf /var/lib/apt/lists/*

# The CPU's torch: PyPI's own wheel for Linux brings gigabytes of CUDA libraries along.
ENV PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu \
    PIP_NO_CACHE_DIR=1 \
    UV_NO_CACHE=1

WORKDIR /mrtask

COPY . .
# KubeRay runs `ray` and `mrtask` in a login shell, which knows no other PATH than the system's.
RUN make install && .venv/bin/python -m uv pip install --python .venv/bin/python --constraint constraints.txt \
        --editable '.[cluster,s3]' && \
    ln -s /mrtask/.venv/bin/ray /mrtask/.venv/bin/mrtask /usr/local/bin/

ENTRYPOINT ["make", "--no-print-directory"]
CMD ["reproduce", "EXPERIMENT=smoke"]
