# The package in ROS 2 Jazzy:
#
#   docker build --tag pendubot .
#   docker run --rm pendubot ros2 launch pendubot_identification virtual.launch.py view:=false
#   docker run --rm --network host --device /dev/pendubot pendubot ros2 run pendubot_identification bridge
FROM ros:jazzy

# rosdep installs two packages from PyPI, which Ubuntu allows nobody without this.
ENV PIP_BREAK_SYSTEM_PACKAGES=1
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /workspace
COPY . src/pendubot_identification
# RViz runs where the screen is.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-pip \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src src/pendubot_identification/pendubot_interfaces --ignore-src --default-yes \
        --skip-keys rviz2 --dependency-types buildtool --dependency-types build --dependency-types exec \
    && rm -rf /var/lib/apt/lists/*
RUN source /opt/ros/jazzy/setup.bash \
    && colcon build --base-paths src src/pendubot_identification/pendubot_interfaces

ENTRYPOINT ["/bin/bash", "-c", "source install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "run", "pendubot_identification", "pendubot", "--help"]
