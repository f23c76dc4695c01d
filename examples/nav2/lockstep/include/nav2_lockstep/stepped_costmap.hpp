// A costmap of Nav2 that is updated when it is told to, at a time that it is told.

#ifndef NAV2_LOCKSTEP__STEPPED_COSTMAP_HPP_
#define NAV2_LOCKSTEP__STEPPED_COSTMAP_HPP_

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "geometry_msgs/msg/transform_stamped.hpp"
#include "nav2_costmap_2d/obstacle_layer.hpp"
#include "nav2_lockstep/versions.hpp"
#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/laser_scan.hpp"

namespace nav2_lockstep
{

// Let a node's clock show what set_time says; without this it shows the machine's time.
void take_over_clock(const rclcpp::Clock::SharedPtr & clock);

// Set a clock that was taken over.
void set_time(const rclcpp::Clock::SharedPtr & clock, const rclcpp::Time & now);

// Nav2's Costmap2DROS, configured by its own parameters and never activated: it has no thread that updates it, and
// its obstacle layers are handed the scans instead of subscribing to them.
class SteppedCostmap
{
public:
  // Make the node NAME/NAME and configure it. std::runtime_error if Nav2 refuses its parameters, or if a source of an
  // obstacle layer is not a laser scan.
  explicit SteppedCostmap(const std::string & name);
  ~SteppedCostmap();
  SteppedCostmap(const SteppedCostmap &) = delete;
  SteppedCostmap & operator=(const SteppedCostmap &) = delete;

  void set_time(const rclcpp::Time & now);
  void set_transform(const geometry_msgs::msg::TransformStamped & transform, bool is_static);

  // Hand the scan to all sources of all obstacle layers, and update the costmap around the robot where its parameter
  // update_frequency has it due, by the time that was set. std::runtime_error if the robot's pose in the costmap's frame
  // has not been told.
  void update(const sensor_msgs::msg::LaserScan::ConstSharedPtr & scan);

  // Forget all obstacles, as Nav2's service clear_entirely does. The next scan updates the costmap.
  void clear();

  // Whether all layers have what they need: a static layer its map.
  bool is_current() const;

  const std::shared_ptr<nav2_costmap_2d::Costmap2DROS> & ros() const {return ros_;}

private:
  struct Source
  {
    nav2_costmap_2d::ObstacleLayer * layer;
    std::shared_ptr<nav2_costmap_2d::ObservationBuffer> buffer;
    bool inf_is_valid;
  };

  void find_sources();
  bool is_due() const;

  std::shared_ptr<nav2_costmap_2d::Costmap2DROS> ros_;
  std::vector<Source> sources_;
  rclcpp::Duration period_{0, 0};
  std::optional<rclcpp::Time> updated_;
};

}  // namespace nav2_lockstep

#endif  // NAV2_LOCKSTEP__STEPPED_COSTMAP_HPP_
