# docker build -t railrepro . && docker run --rm -p 8888:8888 railrepro
FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends gcc git libc6-dev make && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home railrepro
USER railrepro
WORKDIR /home/railrepro/clone
COPY --chown=railrepro . .
RUN make setup
EXPOSE 8888
CMD ["make", "lab", "LAB=--no-browser --ip=0.0.0.0"]
