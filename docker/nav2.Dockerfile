# syntax=docker/dockerfile:1.7
# Nav2 for the Jackal, to be benchmarked from another container: see compose.nav2.yaml.
ARG ROS_IMAGE=ros:jazzy-ros-base-noble@sha256:386d06ec6d4188f731bae5678e07b4cb64a4e4d4152090c0bd1f881dcf7706f5

FROM ${ROS_IMAGE}
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        ros-jazzy-navigation2=1.3.* \
    && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home --uid 10001 nav2
COPY examples/nav2 /nav2
ENV ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST \
    PYTHONDONTWRITEBYTECODE=1
USER 10001:10001
WORKDIR /nav2
# the image's own entrypoint sources ROS
CMD ["ros2", "launch", "/nav2/nav2.launch.py"]
