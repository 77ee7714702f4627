# slidectl in a container: the daemon in the foreground, as a user without rights.
#   docker build -t slidectl .
#   docker run --rm -v "$PWD:/work" slidectl test scenarios/
FROM python:3.13-slim

COPY . /src
RUN python -m pip install --no-cache-dir "/src[fast,test]" && rm -rf /src
RUN useradd --create-home robot && install -d -o robot -g robot -m 700 /run/slidectl
USER robot
ENV XDG_RUNTIME_DIR=/run/slidectl
WORKDIR /work
ENTRYPOINT ["slidectl"]
CMD ["daemon", "run"]
