FROM python:3.12-slim
WORKDIR /opt/isogi
COPY requirements.lock pyproject.toml README.md LICENSE ./
RUN pip install --no-cache-dir --require-hashes -r requirements.lock
COPY isogi_core isogi_core
COPY worker worker
COPY server server
COPY web web
RUN pip install --no-cache-dir --no-deps . \
 && useradd --create-home isogi && mkdir -p /light && chown isogi /light
USER isogi
ENV ISOGI_STORE=/light
VOLUME ["/light"]
EXPOSE 8000
# needs ISOGI_TOKEN: others can reach it
CMD ["isogi", "serve", "--host", "0.0.0.0"]
