// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0

#include <map>
#include <memory>
#include <sstream>
#include <string>

#include "diagnostic_msgs/msg/diagnostic_array.hpp"
#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"

class Controller : public rclcpp::Node
{
public:
  Controller() : Node("controller")
  {
    const auto latched = rclcpp::QoS(1).reliable().transient_local();
    identification_ = create_subscription<diagnostic_msgs::msg::DiagnosticArray>(
      "pendubot/identification", latched,
      [this](diagnostic_msgs::msg::DiagnosticArray::ConstSharedPtr message) {
        const auto & status = message->status.at(0);
        trusted_ = status.level == diagnostic_msgs::msg::DiagnosticStatus::OK;
        RCLCPP_INFO(get_logger(), "level %d: %s", static_cast<int>(status.level), status.message.c_str());
      });
    parameters_subscription_ = create_subscription<std_msgs::msg::Float64MultiArray>(
      "pendubot/params", latched,
      [this](std_msgs::msg::Float64MultiArray::ConstSharedPtr message) {
        std::istringstream names(message->layout.dim.at(0).label);
        std::string name;
        for (const double value : message->data) {
          std::getline(names, name, ',');
          parameters_[name] = value;
          RCLCPP_INFO(get_logger(), "%s = %.9g", name.c_str(), value);
        }
      });
  }

private:
  bool trusted_ = false;
  std::map<std::string, double> parameters_;
  rclcpp::Subscription<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr identification_;
  rclcpp::Subscription<std_msgs::msg::Float64MultiArray>::SharedPtr parameters_subscription_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<Controller>());
  rclcpp::shutdown();
  return 0;
}
