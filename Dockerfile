# mjmerge in a container: docker build -t mjmerge . && docker run --rm -v "$PWD":/work mjmerge run paper
FROM python:3.12-slim
COPY . /src
RUN pip install --no-cache-dir -c /src/constraints.txt '/src[laws,search]' && rm -r /src
WORKDIR /work
ENTRYPOINT ["mjmerge"]
