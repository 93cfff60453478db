# bcid on the DOLFINx project's own image: v0.10.0 (Ubuntu, real scalars by default, MPICH), the middle one of the three
# supported versions; 0.9 is what ./dev makes and 0.11 what ./dev --suite sid makes.
#
#     docker build -t bcid .
#     docker run --rm -it -v "$PWD":/data -w /data bcid bcid doctor
FROM dolfinx/dolfinx:v0.10.0

# VTK draws off screen through EGL; without a display it would otherwise look for one first.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1 \
    && rm -rf /var/lib/apt/lists/*
ENV VTK_DEFAULT_OPENGL_WINDOW=vtkEGLRenderWindow OMP_NUM_THREADS=1

# NumPy stays the one that the image's petsc4py and DOLFINx were built for.
COPY environment/wheels.txt /tmp/wheels.txt
RUN python3 -c 'import numpy; print(f"numpy=={numpy.__version__}")' >/tmp/constraints.txt \
    && python3 -m pip install --no-cache-dir --break-system-packages -r /tmp/wheels.txt -c /tmp/constraints.txt scipy \
    && rm /tmp/wheels.txt /tmp/constraints.txt

COPY . /opt/bcid
RUN python3 -m pip install --no-cache-dir --break-system-packages --no-deps /opt/bcid
CMD ["bcid", "doctor"]
