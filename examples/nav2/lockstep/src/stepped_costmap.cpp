#include "nav2_lockstep/stepped_costmap.hpp"

#include <sstream>
#include <stdexcept>

#include "lifecycle_msgs/msg/state.hpp"
#include "rcl/time.h"

namespace nav2_lockstep
{

namespace
{

constexpr char kAuthority[] = "nav2_lockstep";

// Gives access to a layer's buffers, which only its subscriptions know.
struct OpenLayer : nav2_costmap_2d::ObstacleLayer
{
  static const std::vector<std::shared_ptr<nav2_costmap_2d::ObservationBuffer>> & buffers(
    nav2_costmap_2d::ObstacleLayer & layer)
  {
    return layer.*(&OpenLayer::observation_buffers_);
  }
};

}  // namespace

void take_over_clock(const rclcpp::Clock::SharedPtr & clock)
{
  std::lock_guard<std::mutex> lock(clock->get_clock_mutex());
  if (rcl_enable_ros_time_override(clock->get_clock_handle()) != RCL_RET_OK) {
    throw std::runtime_error("a clock cannot be taken over");
  }
}

void set_time(const rclcpp::Clock::SharedPtr & clock, const rclcpp::Time & now)
{
  std::lock_guard<std::mutex> lock(clock->get_clock_mutex());
  if (rcl_set_ros_time_override(clock->get_clock_handle(), now.nanoseconds()) != RCL_RET_OK) {
    throw std::runtime_error("a clock cannot be set");
  }
}

SteppedCostmap::SteppedCostmap(const std::string & name)
: ros_(make_costmap(name))
{
  take_over_clock(ros_->get_clock());
  if (ros_->configure().id() != lifecycle_msgs::msg::State::PRIMARY_STATE_INACTIVE) {
    throw std::runtime_error(name + " cannot be configured");
  }
  ros_->getTfBuffer()->setUsingDedicatedThread(true);  // transforms are there before they are asked for
  const double rate_hz = ros_->get_parameter("update_frequency").as_double();
  if (rate_hz <= 0.0) {
    throw std::runtime_error(name + ": update_frequency must be above 0, got " + std::to_string(rate_hz));
  }
  period_ = rclcpp::Duration::from_seconds(1.0 / rate_hz);
  find_sources();
  for (const auto & layer : *ros_->getLayeredCostmap()->getPlugins()) {
    // to activate an obstacle layer is to let it subscribe
    if (!std::dynamic_pointer_cast<nav2_costmap_2d::ObstacleLayer>(layer)) {
      layer->activate();
    }
  }
}

SteppedCostmap::~SteppedCostmap()
{
  ros_->cleanup();
}

void SteppedCostmap::find_sources()
{
  for (const auto & plugin : *ros_->getLayeredCostmap()->getPlugins()) {
    auto * layer = dynamic_cast<nav2_costmap_2d::ObstacleLayer *>(plugin.get());
    if (layer == nullptr) {
      continue;
    }
    const auto & buffers = OpenLayer::buffers(*layer);
    std::istringstream names(
      ros_->get_parameter(layer->getName() + ".observation_sources").as_string());
    std::string name;
    for (std::size_t i = 0; names >> name; ++i) {
      const std::string prefix = layer->getName() + "." + name + ".";
      if (ros_->get_parameter(prefix + "data_type").as_string() != "LaserScan") {
        throw std::runtime_error(prefix + "data_type must be LaserScan");
      }
      sources_.push_back(
        {layer, buffers.at(i), ros_->get_parameter(prefix + "inf_is_valid").as_bool()});
    }
  }
}

void SteppedCostmap::set_time(const rclcpp::Time & now)
{
  nav2_lockstep::set_time(ros_->get_clock(), now);
}

void SteppedCostmap::set_transform(
  const geometry_msgs::msg::TransformStamped & transform, bool is_static)
{
  ros_->getTfBuffer()->setTransform(transform, kAuthority, is_static);
}

void SteppedCostmap::update(const sensor_msgs::msg::LaserScan::ConstSharedPtr & scan)
{
  // Nav2 would wait for ever for it: its clock stands still meanwhile
  if (!ros_->getTfBuffer()->tf2::BufferCore::canTransform(
      ros_->getGlobalFrameID(), ros_->getBaseFrameID(), tf2::TimePointZero))
  {
    throw std::runtime_error(
      std::string(ros_->get_name()) + ": no transform from robot_base_frame " + ros_->getBaseFrameID() +
      " to global_frame " + ros_->getGlobalFrameID());
  }
  for (const auto & source : sources_) {
    if (source.inf_is_valid) {
      source.layer->laserScanValidInfCallback(scan, source.buffer);
    } else {
      source.layer->laserScanCallback(scan, source.buffer);
    }
  }
  if (is_due()) {
    ros_->updateMap();
    updated_ = ros_->now();
  }
}

bool SteppedCostmap::is_due() const
{
  return !updated_ || ros_->now() - *updated_ >= period_;
}

void SteppedCostmap::clear()
{
  ros_->resetLayers();
  updated_.reset();
}

bool SteppedCostmap::is_current() const
{
  return ros_->isCurrent();
}

}  // namespace nav2_lockstep
