FROM python:3.12-slim@sha256:78387bc3881b8273120a12ebe6c1ab22b018ccc2c9adf565ae1ac9b536e184ea
WORKDIR /opt/isogi
COPY requirements.lock pyproject.toml README.md LICENSE isogi_client.py isogi_widget.py ./
RUN pip install --no-cache-dir --require-hashes -r requirements.lock
COPY isogi isogi
COPY isogi_core isogi_core
COPY worker worker
COPY server server
COPY isogi_report isogi_report
COPY web web
# Compiled kernels are known by the times of their sources too: whole seconds, as layers may keep no parts of them.
RUN pip install --no-cache-dir --no-compile --no-deps . \
 && find /usr/local/lib/python3.12/site-packages/isogi_core -name '*.py' -exec touch -d @1000000000 '{}' + \
 && python -m compileall -q /usr/local/lib/python3.12/site-packages/isogi_core \
 && rm -r isogi_core worker server isogi_report web \
 && useradd --create-home isogi && mkdir -p /light /var/cache/isogi && chown isogi /light /var/cache/isogi
USER isogi
ENV ISOGI_STORE=/light XDG_CACHE_HOME=/var/cache
COPY tests/compile_kernels.py ./
RUN python compile_kernels.py
VOLUME ["/light"]
EXPOSE 8000
# needs ISOGI_TOKEN, or --token-file: others can reach it
CMD ["isogi", "serve", "--host", "0.0.0.0"]
